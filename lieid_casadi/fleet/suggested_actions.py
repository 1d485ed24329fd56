"""What to do about a change, for each effect that a diagnosis can name."""

from __future__ import annotations

INSPECT = "inspect the joint, and identify the arm again if it is in order"
ACTIONS = {
    "coulomb": "check lubrication, seals and brake of the joint; a steady rise indicates wear",
    "viscous": "check lubricant and temperature of the joint",
    "viscous_polynomial": "check lubricant and temperature of the joint",
    "viscous_asymmetric": "check lubricant and seals of the joint",
    "stribeck": "check lubrication of the joint; slow motion shows the change most",
    "load_friction": "check bearings and gear of the joint under load",
    "temperature_friction": "record temperatures, and identify with temperature_friction",
    "warm_up": "warm the arm up before the nightly motion",
    "position_friction": "inspect the bearing and gear of the joint over its whole range",
    "presliding": "check the gear of the joint for tooth contact and preload",
    "torque_ripple": "inspect gear and bearing of the joint for local damage",
    "backlash": "inspect the gear of the joint for wear",
    "joint_elasticity": "check the fixings of gear and motor of the joint",
    "position_spring": "check hoses, cables and balancers at the joint",
    "transmission_coupling": "inspect the gear that the two joints share",
    "armature": "check that motor and gear of the joint are those of the fit",
    "offset": "check the zero of the torque sensor and hoses or cables at the joint",
    "torque_gain": "check current sensor, drive settings and torque constant of the joint",
    "torque_delay": "check the drive's filter and the time stamps of the recording",
    "time_shift": "check the time stamps of the recording",
    "torque_lowpass": "check the filter settings of the drives",
    "bias_drift": "check the zero of the torque sensor over time",
    "encoder_offset": "check the zero position of the joint and its coupling to the encoder",
    "base_tilt": "check the bolts of the base and the level of the floor",
    "payload": "check what is mounted on the tool, and the payload in the fleet file",
    "external_wrench": "check for contact, hoses or cables at the tool",
    "error": "look at the diagnosis of the last night's recording",
    "unexplained": "look at the diagnosis of the last night's recording",
}


def suggested_action(quantity: str) -> str:
    """Return what to do about a change of a quantity, an effect or ``error``.

    Examples
    --------
    >>> suggested_action("base_tilt")
    'check the bolts of the base and the level of the floor'
    """
    return ACTIONS.get(quantity, INSPECT)
