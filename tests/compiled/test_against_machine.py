"""Compiled functions against CasADi's machine and wider numbers, on every instruction set."""

import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest
from robot.random_arms import random_arm, random_states

import lieid_casadi as lieid
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.compiled import compile
from lieid_casadi.compiled.batch_evaluation import CompiledEvaluation, MachineEvaluation
from lieid_casadi.compiled.kernel_source import kernel_source
from lieid_casadi.compiled.kernels import FLAGS, TARGETS, available_targets
from lieid_casadi.effects import Coefficient, Effect
from lieid_casadi.expressions.model_functions import ModelFunctions

pytestmark = pytest.mark.usefixtures("compiler")

EFFECTS = (
    "coulomb,viscous,offset,viscous_polynomial,viscous_asymmetric,stribeck,load_friction/paper,"
    "armature"
)
LANES = [target.lanes for target in available_targets()]
ROBOTS = {
    "panda": lieid.robots.panda,
    "two_link": lieid.robots.two_link,
    "revolute_6": lambda: random_arm(np.random.default_rng(1), 6, mixed=False),
    "mixed_4": lambda: random_arm(np.random.default_rng(2), 4),
    "mixed_1": lambda: random_arm(np.random.default_rng(3), 1),
    "one_slide": lambda: sliding_robot(),
}
LARGE = ("panda", "revolute_6")


def sliding_robot():
    robot = random_arm(np.random.default_rng(4), 3)
    slides = [joint for joint in robot.joints if not joint.revolute]
    return lieid.Robot("slide", tuple(slides[:1]), robot.gravity, robot.tool)


def calls(model, samples=21, seed=0):
    """Every public function with arguments for it."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = random_states(rng, model.robot, samples)
    load = rng.normal(size=q.shape)
    links, strength = rng.normal(size=10 * model.n), rng.normal(size=len(model.columns))
    signals = {
        "load": load,
        "temperature": 10 * load,
        "time": np.sort(rng.random(samples)),
        "dead_zone": np.full(model.n, 0.5),
        "shapes": 1.1 * model.initial_shapes,
    }
    motion = (q, dq, ddq)
    return {
        "regressor": (motion, {}),
        "base_regressor": (motion, signals),
        "effect_columns": (motion, signals),
        "inverse_dynamics": ((*motion, links), {}),
        "effect_torque": ((*motion, strength), signals),
        "mass_matrix": ((q, links), {}),
        "gravity": ((q, links), {}),
        "jacobian": ((q,), {}),
    }


def on_machine(model):
    """The same model as it is evaluated without a compiler."""
    arm = compile(model)
    arm._kernels.get = arm._memory.get = lambda names: None
    return arm


@pytest.mark.parametrize(
    ("name", "lanes"),
    [
        *((name, LANES[0]) for name in ROBOTS if name not in LARGE),
        *(pytest.param(name, LANES[0], marks=pytest.mark.slow) for name in LARGE),
        ("mixed_4", LANES[-1]),
        *(pytest.param("mixed_4", lanes, marks=pytest.mark.slow) for lanes in LANES[1:-1]),
    ],
)
def test_every_function_agrees_with_the_virtual_machine(name, lanes):
    model = lieid.Model(ROBOTS[name](), effects=EFFECTS)
    fast, slow = compile(model, lanes=lanes), on_machine(model)
    for function, (arguments, signals) in calls(model).items():
        got = getattr(fast, function)(*arguments, **signals)
        expected = getattr(slow, function)(*arguments, **signals)
        assert isinstance(fast._evaluation(function), CompiledEvaluation)
        assert isinstance(slow._evaluation(function), MachineEvaluation)
        assert got.shape == expected.shape
        scale = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(got, expected, rtol=1e-13, atol=1e-13 * scale, err_msg=function)


@pytest.mark.skipif(len(LANES) < 2, reason="this processor has one instruction set")
@pytest.mark.parametrize("name", ["two_link", pytest.param("panda", marks=pytest.mark.slow)])
def test_results_have_the_same_bits_with_any_number_of_lanes(name):
    model = lieid.Model(ROBOTS[name](), effects=EFFECTS)
    arms = [compile(model, lanes=lanes) for lanes in LANES]
    for function, (arguments, signals) in calls(model).items():
        first, *others = (getattr(arm, function)(*arguments, **signals) for arm in arms)
        for other in others:
            np.testing.assert_array_equal(first, other, err_msg=function)


def test_effects_with_memory_follow_the_samples():
    model = lieid.Model(lieid.robots.two_link(), effects="presliding,presliding/lugre,coulomb")
    fast, slow = compile(model), on_machine(model)
    for samples in (0, 1, 2, 700):
        (q, dq, ddq), signals = calls(model, samples=samples)["base_regressor"]
        expected = slow.base_regressor(q / 20, dq, ddq, **signals)
        got = fast.base_regressor(q / 20, dq, ddq, **signals)
        np.testing.assert_allclose(got, expected, rtol=1e-13, atol=1e-13)
    column = [c.label for c in model.base_columns].index("presliding.f_c:1")
    assert len(np.unique(got[:, 0, column])) > 100  # a state, not a sign


class Everything(Effect):
    """Every operation that has a C form, on arguments where it is defined."""

    name = "everything"
    formula = "…"
    signals = ("q", "dq", "ddq")

    def __init__(self):
        self.coefficients = tuple(Coefficient(f"c{k}", "1") for k in range(len(self.operations)))

    operations = (
        lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b,
        lambda a, b: -a, lambda a, b: a**2, lambda a, b: a + a, lambda a, b: 1 / b,
        lambda a, b: ca.fabs(b) ** 0.3, lambda a, b: ca.fabs(b) ** a,
        lambda a, b: ca.sqrt(ca.fabs(a)), lambda a, b: ca.fabs(a), lambda a, b: ca.sign(a),
        lambda a, b: ca.fmin(a, b), lambda a, b: ca.fmax(a, b), lambda a, b: ca.exp(a),
        lambda a, b: ca.sin(a), lambda a, b: ca.cos(7 * a), lambda a, b: ca.tan(a),
        lambda a, b: ca.asin(ca.sin(b)), lambda a, b: ca.acos(ca.cos(b)), lambda a, b: ca.atan(b),
        lambda a, b: ca.sinh(a), lambda a, b: ca.cosh(a), lambda a, b: ca.tanh(b),
        lambda a, b: ca.log(ca.fabs(b)), lambda a, b: ca.log1p(ca.fabs(b)),
        lambda a, b: ca.expm1(a), lambda a, b: ca.erf(a), lambda a, b: ca.floor(3 * a),
        lambda a, b: ca.ceil(3 * a), lambda a, b: ca.atan2(a, b), lambda a, b: ca.fmod(a, b),
        lambda a, b: ca.hypot(a, b), lambda a, b: ca.copysign(a, b), lambda a, b: a < b,
        lambda a, b: a <= b, lambda a, b: ca.eq(ca.sign(a), ca.sign(b)),
        lambda a, b: ca.ne(ca.sign(a), ca.sign(b)), lambda a, b: ca.logic_not(a < b),
        lambda a, b: ca.logic_and(a < b, b > 0), lambda a, b: ca.logic_or(a < b, b > 0),
        lambda a, b: ca.if_else(a < b, a, b**2),
    )  # fmt: skip

    def columns(self, s, shape):
        return [operation(s.q, s.dq) for operation in self.operations]


@pytest.mark.parametrize("lanes", LANES)
def test_every_operation_has_the_virtual_machines_result(lanes):
    model = lieid.Model(lieid.robots.two_link(), effects=[Everything()])
    fast, slow = compile(model, lanes=lanes), on_machine(model)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 50, 2))
    got, expected = fast.effect_columns(q, dq, ddq), slow.effect_columns(q, dq, ddq)
    assert isinstance(fast._evaluation("effect_columns"), CompiledEvaluation)
    np.testing.assert_allclose(got, expected, rtol=2e-15, atol=1e-300)
    assert len(np.unique(np.abs(got[:, 0]).max(axis=0))) > 25


def test_an_operation_without_a_c_form_leaves_the_rest_compiled(caplog):
    class Inverse(Effect):
        name, formula, signals = "inverse", "asinh(q̇)", ("dq",)
        coefficients = (Coefficient("c", "1"),)

        def columns(self, s, shape):
            return [ca.asinh(s.dq)]

    arm = compile(lieid.Model(lieid.robots.two_link(), effects=[Inverse()]))
    q = np.linspace(-1, 1, 20).reshape(10, 2)
    np.testing.assert_allclose(arm.effect_columns(q, q, q)[:, 1, 1], np.arcsinh(q[:, 1]))
    assert "ASINH" in caplog.text
    arm.regressor(q, q, q)
    assert isinstance(arm._evaluation("regressor"), CompiledEvaluation)


NEON = next(target for target in TARGETS if target.name == "neon")
COMPILER, DUMP = "aarch64-linux-gnu-gcc", "aarch64-linux-gnu-objdump"


@pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"no {COMPILER}")
@pytest.mark.parametrize("name", ["lieid_batch.c", "lieid_reduce.c", "kernel.c"])
def test_everything_builds_for_neon(name, tmp_path):
    source = codegen_folder() / name
    if name == "kernel.c":
        source = tmp_path / name
        functions = ModelFunctions(lieid.Model(lieid.robots.two_link(), "coulomb,stribeck"))
        source.write_text(kernel_source(functions.effect_columns))
    options = [*FLAGS, *NEON.flags, f"-DLIEID_LANES={NEON.lanes}", f"-I{codegen_folder()}"]
    made = str(tmp_path / "made.so")
    subprocess.run([COMPILER, *options, "-Wall", "-Werror", str(source), "-o", made], check=True)
    shown = subprocess.run([DUMP, "-d", made], check=True, capture_output=True, text=True).stdout
    assert "v0.2d" in shown  # two doubles per register


class Functions(Effect):
    name, formula, signals = "functions", "sin q, cos q, exp q", ("q",)
    coefficients = (Coefficient("s", "1"), Coefficient("c", "1"), Coefficient("e", "1"))

    def columns(self, s, shape):
        return [ca.sin(s.q), ca.cos(s.q), ca.exp(s.q)]


def evaluate(x, lanes):
    """sin x, cos x, exp x by the C runtime."""
    arm = compile(lieid.Model(lieid.robots.two_link(), effects=[Functions()]), lanes=lanes)
    q = np.column_stack([x, x])
    values = arm.effect_columns(q, q, q)[:, 0, :3]
    assert isinstance(arm._evaluation("effect_columns"), CompiledEvaluation)
    return values.T


def error(got, exact):
    """Error in units of the last place of the exact result."""
    return np.abs((got - exact) / np.spacing(np.abs(exact).astype(float))).max()


ZEROS = np.arange(-3000, 3000) * (np.pi / 2)
NEAR_ZEROS = [
    ZEROS,
    np.nextafter(ZEROS, np.inf),
    ZEROS + 1e-7,
    np.arange(50_000, 70_000) * (np.pi / 2),
]


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="no wider numbers to compare with")
@pytest.mark.parametrize("lanes", LANES)
def test_functions_are_exact_to_one_unit(lanes):
    sizes = np.array([1e-9, 1e-3, 1.0, 10.0, 1e3, 3e4, 1e6, 1e15, 1e300])
    random = (sizes[:, None] * np.random.default_rng(0).normal(size=20_000)).ravel()
    for x, units in ((random, 1.0), (np.concatenate(NEAR_ZEROS), 1.5)):
        sine, cosine, _ = evaluate(x, lanes)
        assert error(sine, np.sin(x.astype(np.longdouble))) < units
        assert error(cosine, np.cos(x.astype(np.longdouble))) < units
    x = np.concatenate([np.linspace(-708, 709.7, 40_001), np.linspace(-1e-8, 1e-8, 101)])
    assert error(evaluate(x, lanes)[2], np.exp(x.astype(np.longdouble))) < 1.0


@pytest.mark.parametrize("lanes", LANES)
def test_ends_of_the_range(lanes):
    x = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, 710.0, 1e308, -745.0, -746.0, -1e308])
    with np.errstate(all="ignore"):
        expected = np.sin(x), np.cos(x), np.exp(x)
    for got, exact in zip(evaluate(x, lanes), expected, strict=True):
        np.testing.assert_allclose(got, exact, rtol=1e-15, atol=1e-323)
