"""What is public, and what importing the package costs."""

import subprocess
import sys

import lieid_casadi as lieid

PUBLIC = {
    "CartesianSpeed", "Coefficient", "Comparison", "Compiled",
    "Diagnosis", "Discrimination", "Drive", "DriveGains", "Effect", "Excitation", "Experiment",
    "Export", "Fit", "FrictionFit", "Joint", "LieidError",
    "LieidWarning", "Limits", "Model", "Obstacle", "PayloadEstimate",
    "PlannedMotion", "PremiseCheck", "Processing", "Recording", "Robot", "SelfCollision", "Shape",
    "Signals", "Simulation", "SymbolicDynamics", "Torque", "Wall",
    "__version__", "check", "compare", "compile", "default_limits", "diagnose",
    "discriminate", "drive_gains", "effect", "excite", "experiment", "export", "extend", "floor",
    "friction", "identify", "identify_payload", "predict",
    "register", "robots", "servo_drive", "simulate", "symbolic", "workspace_box",
}  # fmt: skip


def test_public_names():
    """A change here is a change of the public interface: say so in the CHANGELOG."""
    assert set(lieid.__all__) == PUBLIC
    assert all(getattr(lieid, name) is not None for name in PUBLIC)
    assert set(dir(lieid)) == PUBLIC


def test_importing_is_quick():
    """Heavy libraries are imported where they are used."""
    script = (
        "import sys, lieid_casadi, lieid_casadi.cli.main as m; m.build_parser(); "
        "heavy = {'casadi', 'pinocchio', 'matplotlib', 'cvxpy', 'scipy', 'numpy'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
