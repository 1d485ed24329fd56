"""Exported C against Pinocchio in C++: ``python tests/benchmarks/against_pinocchio.py [ROBOT…]``.

One call each, in turns in one process: medians of processor time. Pinocchio's algorithms are those
of the library in the wheel ``pin``, a release build for any x86-64 processor, called by a program
without optimization; with ``--headers`` they are compiled from the wheel's headers by the same
compiler and flags as the exported C, which takes minutes and 4 GB. Eigen 3 (``libeigen3-dev``) and
a C++ compiler are needed. Differences are of the last results, relative.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import numpy as np  # noqa: E402
from exporters.c_arms import made_fit  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.exporters.c.export import export_c  # noqa: E402
from lieid_casadi.robot.geometry import relative  # noqa: E402

FLAGS = ("-O3", "-DNDEBUG")
DEFINITIONS = (  # those of Pinocchio's CMake targets
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)
COMPILED = ("-O0", "-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION")  # -O0: no copies of its own
EIGEN = "/usr/include/eigen3"


def nominal(robot):
    """A fit without effects whose link parameters are the robot's own."""
    fit = made_fit(robot, "")
    links = robot.link_parameters
    return dataclasses.replace(
        fit, parameters=links, values=fit.model.base.combination @ links, method="feasible"
    )


def wheel():
    """Folder of Pinocchio's headers and libraries."""
    import pinocchio

    return next(p for p in Path(pinocchio.__file__).parents if (p / "include/pinocchio").is_dir())


def numbers(robot):
    """Gravity, then placement, axis and link parameters of each joint, then the tool."""
    rows, before = [robot.gravity], np.eye(4)
    for joint in robot.joints:
        if not joint.revolute or np.abs(joint.axis[3:]).max() > 1e-9:
            raise SystemExit(f"{robot.name}: expected revolute joints about their frames' origins")
        axis = np.round(joint.axis[:3], 12)
        rows += [relative(before, joint.home).ravel(), axis, joint.link]
        before = joint.home
    rows.append(robot.tool.ravel())
    gravity, *others = (" ".join(repr(float(x)) for x in row) for row in rows)
    return "\n".join([gravity, str(robot.n), *others]) + "\n"


def measured(robot, folder, flags, *, headers):
    """Name, nanoseconds of this package and of Pinocchio, difference; one row a function."""
    fit = nominal(robot)
    export_c(fit, folder / "arm")
    (folder / "arm.txt").write_text(numbers(robot))
    prefix, program = wheel(), folder / "calls"
    subprocess.run(["gcc", "-std=c99", *flags, "-c", "arm.c"], cwd=folder / "arm", check=True)
    subprocess.run(
        [
            "g++", "-std=c++17", *(flags if headers else (*COMPILED, "-DNDEBUG")), *DEFINITIONS,
            f"-I{prefix}/include", f"-isystem{EIGEN}",
            f"-I{folder}/arm", str(HERE / "pinocchio_calls.cpp"), str(folder / "arm/arm.o"),
            f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-lpinocchio_default",
            "-o", str(program),
        ],
        check=True,
    )  # fmt: skip
    shown = subprocess.run(
        [program, folder / "arm.txt"], check=True, capture_output=True, text=True
    ).stdout
    return [line.split("\t") for line in shown.splitlines()]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", default=["panda"], metavar="ROBOT")
    parser.add_argument("--flags", default=" ".join(FLAGS), help=f"default: {' '.join(FLAGS)}")
    parser.add_argument("--headers", action="store_true", help="compile Pinocchio's algorithms")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for name in options.robots:
        robot = lieid.Robot.load(name)
        with tempfile.TemporaryDirectory() as scratch:
            rows = measured(robot, Path(scratch), options.flags.split(), headers=options.headers)
        table = Table(title=f"{robot.name}, {robot.n} joints, {options.flags}, ns per call")
        for heading in ("function", "exported C", "Pinocchio", "ratio", "difference"):
            table.add_column(heading, justify="left" if heading == "function" else "right")
        for function, ours, theirs, difference in rows:
            ratio = float(theirs) / float(ours)
            table.add_row(
                function, f"{float(ours):.0f}", f"{float(theirs):.0f}", f"{ratio:.1f}×", difference
            )
            assert float(difference) < 1e-10 or np.isnan(float(difference)), function
        Console(width=100).print(table)


if __name__ == "__main__":
    main()
