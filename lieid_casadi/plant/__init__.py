"""A simulated arm to measure: Pinocchio dynamics, joint control, sensors, hidden effects.

It shares no dynamics and no effects with the rest of the package, so that it reveals errors there.
"""

from lieid_casadi.plant.arm import Arm, JointFriction, Thermal, perturbed_inertias, with_payload
from lieid_casadi.plant.demo_arm import HIDDEN_EFFECT_NAMES, demo_arm, demo_sensors, hidden_effect
from lieid_casadi.plant.effects import (
    Armature,
    BaseTilt,
    BiasDrift,
    EncoderOffset,
    ExternalWrench,
    ForeignTorque,
    HiddenEffect,
    JointEffect,
    JointElasticity,
    JointState,
    LoadFriction,
    Payload,
    PositionFriction,
    PositionSpring,
    Presliding,
    Stribeck,
    TemperatureFriction,
    TimeShift,
    TorqueDelay,
    TorqueGain,
    TorqueLowpass,
    TorqueRipple,
    TransmissionCoupling,
    ViscousAsymmetric,
    ViscousPolynomial,
    WarmUp,
)
from lieid_casadi.plant.ideal_tracking import TrueMotion, move_along
from lieid_casadi.plant.position_control import PositionDrive, simulate_commands
from lieid_casadi.plant.sensors import Sensors, measure, measure_along
from lieid_casadi.plant.simulate import move, simulate
from lieid_casadi.plant.trajectories import FourierTrajectory, ReferenceTrajectory, torque_scale
from lieid_casadi.robot.pinocchio_model import build_pinocchio

__all__ = [
    "HIDDEN_EFFECT_NAMES", "Arm", "Armature", "BaseTilt", "BiasDrift", "EncoderOffset",
    "ExternalWrench", "ForeignTorque", "FourierTrajectory", "HiddenEffect", "JointEffect",
    "JointElasticity", "JointFriction", "JointState", "LoadFriction", "Payload",
    "PositionDrive", "PositionFriction", "PositionSpring", "Presliding", "ReferenceTrajectory",
    "Sensors", "Stribeck", "TemperatureFriction", "Thermal", "TimeShift", "TorqueDelay",
    "TorqueGain", "TorqueLowpass", "TorqueRipple", "TransmissionCoupling", "TrueMotion",
    "ViscousAsymmetric", "ViscousPolynomial", "WarmUp", "build_pinocchio", "demo_arm",
    "demo_sensors", "hidden_effect", "measure", "measure_along", "move", "move_along",
    "perturbed_inertias", "simulate", "simulate_commands", "torque_scale", "with_payload",
]  # fmt: skip
