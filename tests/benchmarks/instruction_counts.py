"""Operations of inverse dynamics: ``python tests/benchmarks/instruction_counts.py URDF``.

Of exported C with the numbers of the arm, and of the CasADi functions of lieid-casadi,
adam-robotics and urdf2casadi with numbers, where these are installed. Sines and cosines count as
one operation. Torques are compared.
"""

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import casadi as ca  # noqa: E402
import numpy as np  # noqa: E402
from against_pinocchio import nominal  # noqa: E402
from rich.console import Console  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.exporters.c.functions import exported_functions  # noqa: E402

FREE = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER}


def operations(function):
    return sum(function.instruction_id(k) not in FREE for k in range(function.n_instructions()))


def of_adam(urdf, robot):
    """Torque by adam: mass matrix, Coriolis and gravity terms of a base that is held."""
    from adam import Representations
    from adam.casadi import KinDynComputations

    names = [joint.name for joint in robot.joints]
    arm = KinDynComputations(urdf, names, gravity=np.array([0, 0, -9.81, 0, 0, 0]))
    arm.set_frame_velocity_representation(Representations.MIXED_REPRESENTATION)
    q, dq, ddq = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq"))
    still, at_rest = ca.SX(ca.DM.eye(4)), ca.SX.zeros(6)
    mass = arm.mass_matrix(still, q)[6:, 6:]
    bias = arm.bias_force(still, q, at_rest, dq)[6:]
    return ca.Function("tau", [q, dq, ddq], [mass @ ddq + bias], {"cse": True})


def of_urdf2casadi(urdf, robot):
    """Torque by urdf2casadi's recursive Newton-Euler algorithm."""
    import urdf2casadi.urdfparser as parser

    arm = parser.URDFparser()
    arm.from_file(urdf)
    root = _root(Path(urdf).read_text())
    function = arm.get_inverse_dynamics_rnea(root, robot.tool_name, [0, 0, -9.81])
    q, dq, ddq = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq"))
    return ca.Function("tau", [q, dq, ddq], [function(q, dq, ddq)], {"cse": True})


def _root(source):
    from xml.etree import ElementTree

    tree = ElementTree.fromstring(source)
    children = {joint.find("child").get("link") for joint in tree.findall("joint")}
    return next(x.get("name") for x in tree.findall("link") if x.get("name") not in children)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("urdf")
    urdf = parser.parse_args().urdf
    robot, show = lieid.Robot.from_urdf(urdf), Console(width=100).print
    exported = exported_functions(nominal(robot), ["rigid_torque"]).bodies["rigid_torque"]
    show(
        f"exported C: {exported.operations + 2 * robot.n} operations"
    )  # sines and cosines are its inputs
    functions = {"lieid.symbolic": lieid.symbolic(robot).inverse_dynamics}
    for name, make in (("adam-robotics", of_adam), ("urdf2casadi", of_urdf2casadi)):
        try:
            functions[name] = make(urdf, robot)
        except ImportError as error:
            show(f"{name}: not installed ({error})")
    motion = np.random.default_rng(0).uniform(-1.0, 1.0, (3, robot.n))
    expected = functions["lieid.symbolic"](*motion).full()
    for name, function in functions.items():
        error = np.abs(function(*motion).full() - expected).max() / np.abs(expected).max()
        show(f"{name}: {operations(function)} operations, relative difference {error:.1e}")


if __name__ == "__main__":
    main()
