"""Exported C against Pinocchio in C++: ``python tests/benchmarks/against_pinocchio.py [ROBOT…]``.

One call each, in turns in one process: medians of processor time, of three runs. Pinocchio's
algorithms are those of the library in the wheel ``pin``, a release build for any x86-64 processor.
With ``--headers`` they are also compiled from the wheel's headers, by the compiler and with the
flags of the exported C. Compiling takes minutes and 4 GB, once for all robots. Eigen 3
(``libeigen3-dev``, or ``pip install cmeel-eigen``) and GCC are needed. Differences are of the last
results, relative.
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
from lieid_casadi.exporters.export import export  # noqa: E402
from lieid_casadi.robot.inertia import relative  # noqa: E402

FLAGS = ("-O3", "-DNDEBUG")
DEFINITIONS = (  # those of Pinocchio's CMake targets
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)
LIBRARY = (  # calls the library's algorithms: they are not compiled into the program
    "-O2", "-fno-inline", "-DNDEBUG", "-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION"
)  # fmt: skip
EIGEN = "/usr/include/eigen3"
RUNS = 3
LARGEST_DIFFERENCE = 1e-10  # relative


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


def compiled(folder, flags, *, headers):
    """Object file with the calls of Pinocchio, and the arguments that link it."""
    prefix, made = wheel(), folder / f"calls_{'headers' if headers else 'library'}.o"
    subprocess.run(
        [
            "g++", "-std=c++17", *(flags if headers else LIBRARY), *DEFINITIONS, "-DREAL=double",
            f"-I{prefix}/include", f"-isystem{prefix}/include/eigen3", f"-isystem{EIGEN}",
            "-c", str(HERE / "pinocchio_calls.cpp"), "-o", str(made),
        ],
        check=True,
    )  # fmt: skip
    library = [f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-lpinocchio_default"]
    return [str(made), *([] if headers else library)]


def linked(robot, folder, flags, calls):
    """Commands that measure a robot, one for each of the compiled calls."""
    export(nominal(robot), folder / robot.name, to="c")
    (folder / robot.name / "arm.txt").write_text(numbers(robot))
    c = [
        "gcc",
        "-std=c99",
        *flags,
        "-DREAL=double",
        "-I.",
        "-c",
        "arm.c",
        str(HERE / "arm_calls.c"),
    ]
    subprocess.run(c, cwd=folder / robot.name, check=True)
    commands = []
    for k, linking in enumerate(calls):
        program = f"./calls{k}"
        command = ["g++", "arm.o", "arm_calls.o", *linking, "-o", program]
        subprocess.run(command, cwd=folder / robot.name, check=True)
        commands.append([program, "arm.txt"])
    return commands


def measured(folder, commands):
    """Rows: function, ns of the export, ns of Pinocchio and ratio per command, difference."""
    runs = [[_run(folder, command) for command in commands] for _ in range(RUNS)]
    cells = np.array([[[line[1:] for line in rows] for rows in run] for run in runs], float)
    names = [line[0] for line in runs[0][0]]
    ours, theirs, difference = np.moveaxis(cells, -1, 0)  # each: run, command, function
    return list(
        zip(
            names,
            np.median(ours, axis=(0, 1)),
            np.median(theirs, axis=0).T,
            np.median(theirs / ours, axis=0).T,
            difference.max(axis=(0, 1)),
            strict=True,
        )
    )


def _run(folder, command):
    shown = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
    return [line.split("\t") for line in shown.splitlines()]


def show(robot, rows, title, columns):
    table = Table(title=title)
    for heading in ("function", "exported C", *columns, "difference"):
        table.add_column(heading, justify="left" if heading == "function" else "right")
    for name, ours, theirs, ratios, difference in rows:
        cells = [f"{x:.0f}, {ratio:.1f}×" for x, ratio in zip(theirs, ratios, strict=True)]
        table.add_row(name, f"{ours:.0f}", *cells, f"{difference:.0e}")
    Console(width=100).print(table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", default=["panda"], metavar="ROBOT")
    parser.add_argument("--flags", default=" ".join(FLAGS), help=f"default: {' '.join(FLAGS)}")
    parser.add_argument(
        "--headers", action="store_true", help="also compile Pinocchio's algorithms"
    )
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    flags = options.flags.split()
    kinds = ["library", *(["headers"] if options.headers else [])]
    version = subprocess.run(
        ["gcc", "-dumpfullversion"], capture_output=True, text=True, check=True
    )
    compiler = f"GCC {version.stdout.strip()} {options.flags}"
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        calls = [compiled(folder, flags, headers=kind == "headers") for kind in kinds]
        for name in options.robots:
            robot = lieid.Robot.load(name)
            commands = linked(robot, folder, flags, calls)
            rows = measured(folder / robot.name, commands)
            title = f"{robot.name}, {robot.n} joints, {compiler}, ns per call"
            show(robot, rows, title, [f"Pinocchio, {kind}" for kind in kinds])
            for function, *_, difference in rows:
                assert difference < LARGEST_DIFFERENCE, (function, difference)


if __name__ == "__main__":
    main()
