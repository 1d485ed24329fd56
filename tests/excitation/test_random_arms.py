"""What a design lists as checked holds on random arms, by kinematics written here from the URDF.

The arms have revolute, continuous and prismatic joints, shapes on some links only, links of zero
length, frames beyond the tip, and limits with one bound or none.
"""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import lieid_casadi as lieid
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.errors import ExcitationError, NoSolution

CLEARANCE, SPEED = 0.02, 1.5


class Arm:
    """A random serial arm: its URDF, and what a reader of the URDF expects of a motion."""

    def __init__(self, seed):
        rng = self.rng = np.random.default_rng(seed)
        self.n = int(rng.integers(2, 5))
        self.joints, self.shapes, links = [], [], []
        self.kinds = [rng.choice(["revolute", "continuous", "prismatic"], p=[0.7, 0.15, 0.15])
                      for _ in range(self.n)]  # fmt: skip
        self.steps = [np.array([0.0, 0.0, rng.uniform(0.3, 0.6)])]
        for _ in range(self.n):
            long = rng.random() > 0.15
            self.steps.append(np.array([rng.uniform(0.15, 0.4) * long, 0.0, 0.0]))
        self.axes = [np.eye(3)[rng.integers(3)] for _ in range(self.n)]
        self.shapes = [self.shape(k) for k in range(self.n + 1)]
        links = [self.link(k) for k in range(self.n + 1)]
        joints = [self.joint(k) for k in range(self.n)]
        self.beyond = np.array([0.1, 0.05, 0.0])
        ends = [("tip", f"link{self.n}", self.steps[-1]), ("tool0", "tip", self.beyond)]
        fixed = [
            f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{text(xyz)}"/></joint>'
            for name, parent, xyz in ends
        ]
        self.urdf = f'<robot name="panda">{"".join([*links, *joints, *fixed])}</robot>'

    def shape(self, k):
        """Points on a shape in the link's frame, and its URDF; None for most of the time."""
        length = float(max(self.steps[k][0] if k else 0.1, 0.08))
        middle = np.array([0.5 * length, 0.0, 0.0])
        kind = self.rng.choice(["box", "cylinder", "sphere", "none"])
        spread = np.linspace(-1.0, 1.0, 9)
        if kind == "box":
            half = np.array([0.5 * length, 0.03, 0.04])
            grid = np.array(np.meshgrid(spread, spread, spread)).reshape(3, -1).T
            geometry = f'<box size="{text(2.0 * half)}"/>'
            return grid[np.abs(grid).max(axis=1) > 0.99] * half + middle, geometry, middle, ""
        if kind == "cylinder":
            a = np.linspace(0.0, 2.0 * np.pi, 24)
            rim = 0.04 * np.array([np.cos(a), np.sin(a)])
            points = [[0.5 * length * (1 + s), *p] for s in spread for p in rim.T]
            geometry = f'<cylinder radius="0.04" length="{length!r}"/>'
            return np.array(points), geometry, middle, ' rpy="0 1.5707963267948966 0"'
        if kind == "sphere":
            directions = self.rng.normal(size=(100, 3))
            directions /= np.linalg.norm(directions, axis=1)[:, None]
            directions = np.vstack([directions, np.eye(3), -np.eye(3)])
            return 0.06 * directions + middle, '<sphere radius="0.06"/>', middle, ""
        return None

    def link(self, k):
        shape = self.shapes[k]
        collision = ""
        if shape is not None:
            collision = (
                f'<collision><origin xyz="{text(shape[2])}"{shape[3]}/>'
                f"<geometry>{shape[1]}</geometry></collision>"
            )
        inertia = '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/>'
        return (
            f'<link name="link{k}"><inertial><origin xyz="0.1 0 0.02"/><mass value="1"/>{inertia}'
            f"</inertial>{collision}</link>"
        )

    def joint(self, k):
        rng, kind = self.rng, self.kinds[k]
        low, high = (-0.2, 0.2) if kind == "prismatic" else (-2.0, 2.2)
        odd = rng.choice(["both", "lower", "soft"])
        velocity, effort = rng.uniform(0.8, 2.5), rng.choice(["", ' effort="80"'])
        stated = f' lower="{low}" upper="{high}"' if odd != "lower" else f' lower="{low}"'
        self.joints.append((low, 0.0 if odd == "lower" else high, velocity))
        soft = ""
        if odd == "soft":
            soft = (f'<safety_controller k_velocity="1" soft_lower_limit="{0.8 * low}" '
                    f'soft_upper_limit="{0.8 * high}"/>')  # fmt: skip
            self.joints[-1] = (0.8 * low, 0.8 * high, velocity)
        if kind == "continuous":
            stated, soft, self.joints[-1] = "", "", (-np.inf, np.inf, velocity)
        return (
            f'<joint name="j{k}" type="{kind}"><parent link="link{k}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{text(self.steps[k])}"/><axis xyz="{text(self.axes[k])}"/>'
            f'<limit velocity="{velocity!r}"{stated}{effort}/>{soft}</joint>'
        )

    def frames(self, q):
        """Rotations and origins of all links along positions (N, n)."""
        count = len(q)
        rotation, origin = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        placed = [(rotation, origin)]
        for k in range(self.n):
            origin = origin + rotation @ self.steps[k]
            if self.kinds[k] == "prismatic":
                origin = origin + q[:, k : k + 1] * (rotation @ self.axes[k])
            else:
                rotation = rotation @ turned(self.axes[k], q[:, k])
            placed.append((rotation, origin))
        return placed

    def cloud(self, k):
        """Points of a link: on its shape, or on the line to the next joint."""
        if self.shapes[k] is not None:
            return self.shapes[k][0]
        return np.linspace(0.0, 1.0, 9)[:, None] * self.steps[k]


def turned(axis, angle):
    """Rodrigues' formula for a unit axis and angles (N,)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)


def text(values):
    return " ".join(repr(float(x)) for x in values)


def listed(lines, name):
    """The subjects after ``name…: `` in a list of limits, without the reasons."""
    found = []
    for line in lines:
        title, _, subjects = line.replace(" (line)", "").partition(": ")
        if title.startswith(name):
            found += subjects.split(" (")[0].split(", ")
    return set(found)


def verify(arm, found):
    """Assert everything that a design says it has checked, and that nothing is missing."""
    motion = found.motion(500.0)
    low, high, velocity = np.array(arm.joints).T
    names = [f"joint {j + 1}" for j in range(arm.n)]
    for title, excess in (
        ("lower position", low - motion.q),
        ("upper position", motion.q - high),
        ("velocity", np.abs(motion.dq) - 0.8 * velocity),
        ("acceleration", np.abs(motion.ddq) - 3.0),
    ):
        checked, unchecked = (listed(x, title) for x in (found.checked, found.unchecked))
        assert checked ^ unchecked == set(names)
        for j in range(arm.n):
            assert names[j] in unchecked or excess[:, j].max() <= 1e-5
    placed = arm.frames(motion.q)
    clouds = [
        np.einsum("kab,pb->kpa", rotation[::10], arm.cloud(k)) + origin[::10, None]
        for k, (rotation, origin) in enumerate(placed)
    ]
    links = ["the base", *(f"link {k}" for k in range(1, arm.n + 1))]
    above, not_above = (listed(x, "floor") for x in (found.checked, found.unchecked))
    assert above ^ not_above == set(links)
    for k, link in enumerate(links):
        assert link in not_above or clouds[k][:, :, 2].min() >= -1e-4
    short = ["base", *links[1:]]
    pairs = {f"{a} – {b}": (i, i + 1 + j) for i, a in enumerate(short)
             for j, b in enumerate(short[i + 1 :])}  # fmt: skip
    apart, not_apart = listed(found.checked, "0.02 m"), listed(found.unchecked, "self-collision")
    assert apart ^ not_apart == set(pairs)
    for pair, (i, j) in pairs.items():
        if pair in apart and arm.shapes[i] is not None and arm.shapes[j] is not None:
            near = zip(clouds[i][::5], clouds[j][::5], strict=True)
            assert min(cdist(a, b).min() for a, b in near) >= CLEARANCE - 1e-4
    rotation, origin = placed[-1]
    for point in (arm.steps[-1], arm.steps[-1] + arm.beyond):
        path = origin + rotation @ point
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() * 500.0 <= 1.001 * SPEED
    shapeless = {links[k] for k in range(1, arm.n + 1) if arm.shapes[k] is None}
    assert listed(found.unchecked, "shapes") >= shapeless


def designs(seeds, monkeypatch):
    """Yield a random arm with the outcome of its design; without compiled code, to save time."""
    monkeypatch.setattr(Kernels, "get", lambda self, names: None)
    for seed in seeds:
        arm = Arm(seed)
        # the last link before the tool: what lies beyond it moves faster than the tool
        robot = lieid.Robot.parse_urdf(arm.urdf, tip=f"link{arm.n}" if seed % 2 else None)
        try:
            found = lieid.excite(
                lieid.Model(robot), criterion="hadamard", duration=5.0, harmonics=3, samples=40,
                starts=1, max_iterations=8, rate=200.0,
            )  # fmt: skip
        except (NoSolution, ExcitationError) as refused:
            yield arm, refused
        else:
            yield arm, found


def counts(seeds, monkeypatch):
    outcomes = []
    for arm, outcome in designs(seeds, monkeypatch):
        if isinstance(outcome, lieid.Excitation):
            verify(arm, outcome)
        else:
            assert "verification" not in str(outcome)
        outcomes.append(isinstance(outcome, lieid.Excitation))
    return sum(outcomes)


def test_six_random_arms(monkeypatch):
    assert counts(range(6), monkeypatch) >= 3


@pytest.mark.slow
def test_ninety_four_more_random_arms(monkeypatch):
    assert counts(range(6, 100), monkeypatch) >= 37
