"""Batches of any length and layout, threads, bad arrays, NaN."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.compiled.kernels import available_targets
from lieid_casadi.errors import CompilerError, ModelError
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.recording import process

LANES = [target.lanes for target in available_targets()]
MODEL = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous,offset,stribeck:2")


def motion(samples, seed=0, n=2):
    return np.random.default_rng(seed).normal(size=(3, samples, n))


def panda():
    return lieid.Model(lieid.robots.panda(), effects="coulomb,viscous")


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("model", [MODEL, panda()], ids=["two_link", "panda"])
def test_every_length_gives_the_rows_of_the_whole(model, lanes):
    arm, links = compile(model, lanes=lanes), model.robot.link_parameters
    q, dq, ddq = motion(17, n=model.n)
    whole = arm.base_regressor(q, dq, ddq)
    torque = arm.inverse_dynamics(q, dq, ddq, links)
    for count in range(18):
        part = (q[:count], dq[:count], ddq[:count])
        # what lies behind the result must stay as it is
        memory = np.full((count + 2, *whole.shape[1:]), -7.0)
        result = arm.base_regressor(*part, out=memory[:count])
        assert result.shape == (count, *whole.shape[1:])
        np.testing.assert_array_equal(result, whole[:count])
        np.testing.assert_array_equal(memory[count:], -7.0)
        np.testing.assert_array_equal(arm.inverse_dynamics(*part, links), torque[:count])


@pytest.mark.parametrize(
    "layout",
    [
        np.asfortranarray,
        lambda x: x[::-1].copy()[::-1],
        lambda x: np.repeat(x, 2, axis=1)[:, ::2],
        lambda x: x.astype(">f8"),
        lambda x: x.tolist(),
    ],
    ids=["fortran", "reversed", "every_second", "big_endian", "lists"],
)
def test_any_layout_of_the_input_gives_the_same(layout):
    arm, values = compile(MODEL), motion(37)
    expected = arm.regressor(*values)
    np.testing.assert_array_equal(arm.regressor(*(layout(x) for x in values)), expected)


def test_out_may_be_an_input():
    arm, (q, dq, ddq) = compile(MODEL), motion(100)
    links = MODEL.robot.link_parameters
    expected = arm.inverse_dynamics(q, dq, ddq, links)
    memory = np.concatenate([ddq, np.zeros((1, 2))])
    result = arm.inverse_dynamics(q, dq, memory[:-1], links, out=memory[1:])
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize(
    ("out", "found"),
    [
        (np.zeros((5, 2, 19)), "shape"),
        (np.zeros((5, 2, 20), dtype=np.float32), "float32"),
        (np.zeros((5, 20, 2)).transpose(0, 2, 1), "C-contiguous"),
        (np.broadcast_to(0.0, (5, 2, 20)), "writable"),
        ([0.0], "list"),
    ],
)
def test_out_that_does_not_fit_is_refused(out, found):
    with pytest.raises(ModelError, match=f"out: .*{found}"):
        compile(MODEL).regressor(*motion(5), out=out)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        (np.zeros(2), r"q: shape \(2,\); expected \(N, 2\)"),
        (np.zeros((5, 3)), r"q: shape \(5, 3\); expected \(N, 2\)"),
        (np.zeros((5, 2), dtype=complex), "q: dtype complex128; expected real"),
        (np.full((5, 2), "0"), "q: dtype <U1; expected real"),
        ([[0.0, 0.0], [0.0]], "q: "),
        (np.zeros((4, 2)), r"dq: shape \(5, 2\); expected \(4, 2\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(values, found):
    arm, rest = compile(MODEL), np.zeros((5, 2))
    with pytest.raises(ModelError, match=found):
        arm.regressor(values, rest, rest)


def test_other_arguments_that_do_not_fit_are_refused():
    arm, q = compile(MODEL), np.zeros((5, 2))
    for keywords, found in [
        ({"load": np.zeros((4, 2))}, r"load: shape \(4, 2\); expected \(5, 2\)"),
        ({"time": np.zeros(4)}, r"time: shape \(4,\); expected \(5,\)"),
        ({"shapes": np.zeros(2)}, r"shapes: shape \(2,\); expected \(1,\)"),
        ({"dead_zone": 0.0}, r"dead_zone: shape \(\); expected \(2,\)"),
    ]:
        with pytest.raises(ModelError, match=found):
            arm.base_regressor(q, q, q, **keywords)
    with pytest.raises(ModelError, match=r"parameters: shape \(3,\); expected \(20,\)"):
        arm.inverse_dynamics(q, q, q, np.zeros(3))
    with pytest.raises(CompilerError, match="lanes: 3; expected one of"):
        compile(MODEL, lanes=3)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sample_with_nan_affects_no_other(lanes, bad):
    model = panda()
    arm, links = compile(model, lanes=lanes), model.robot.link_parameters
    values = motion(19, n=7)
    expected = arm.base_regressor(*values)
    torque = arm.inverse_dynamics(*values, links)
    for which in range(3):
        for sample in (0, 3, 8, 18):
            spoiled = values.copy()
            spoiled[which, sample, 1] = bad
            others = np.arange(19) != sample
            got = arm.base_regressor(*spoiled)
            np.testing.assert_array_equal(got[others], expected[others])
            got = arm.inverse_dynamics(*spoiled, links)
            np.testing.assert_array_equal(got[others], torque[others])
            assert not np.isfinite(got[sample]).all()


def test_threads_share_a_batch(monkeypatch):
    monkeypatch.setattr("lieid_casadi.compiled.batch_evaluation.SAMPLES_PER_THREAD", 10)
    arm, values = compile(MODEL), motion(1003)
    expected = arm.regressor(*values, threads=1)
    for threads in (2, 3, 7, 50):
        out = np.full(expected.shape, np.nan)
        arm.regressor(*values, out=out, threads=threads)
        np.testing.assert_array_equal(out, expected)


def test_results_larger_than_the_caches_are_the_same(monkeypatch):
    arm, values = compile(panda()), motion(1003, n=7)
    expected = arm.regressor(*values)
    monkeypatch.setattr("lieid_casadi.compiled.batch_evaluation.LAST_LEVEL_CACHE", 0)
    for shift in range(9):  # of the result's address, in doubles
        memory = np.full(expected.size + 18, -7.0)
        out = memory[9 + shift - 4 :][: expected.size].reshape(expected.shape)
        arm.regressor(*values, out=out)
        np.testing.assert_array_equal(out, expected)
        np.testing.assert_array_equal(memory[: 5 + shift], -7.0)
        np.testing.assert_array_equal(memory[5 + shift + expected.size :], -7.0)


def test_a_model_without_effects_has_no_columns_of_them():
    model = lieid.Model(lieid.robots.two_link())
    arm, values = compile(model), motion(5)
    assert arm.effect_columns(*values).shape == (5, 2, 0)
    np.testing.assert_array_equal(arm.effect_torque(*values, []), np.zeros((5, 2)))
    assert arm.base_regressor(*values).shape == (5, 2, model.base.count)


@pytest.mark.parametrize("lanes", LANES)
def test_blocks_are_the_base_regressor_joint_by_joint(lanes):
    model = panda()
    arm, values = compile(model, lanes=lanes), motion(205, n=7)
    signals = {"dead_zone": np.full(7, 0.2)}
    whole = arm.base_regressor(*values, **signals)
    blocks = arm.base_blocks(*values, size=64, **signals)
    joined, buffer = np.zeros_like(whole), blocks.buffer()
    for part in (slice(0, 64), slice(64, 128), slice(128, 192), slice(192, 205)):
        joints = blocks.evaluate(part.start, part.stop, buffer)
        for i, (columns, block) in enumerate(zip(blocks.columns, joints, strict=True)):
            assert block.strides[1] == 8
            joined[part, i, columns] = block.T
    np.testing.assert_array_equal(joined, whole)
    assert [len(columns) for columns in blocks.columns] == np.any(whole, axis=0).sum(
        axis=1
    ).tolist()


def test_the_blocks_of_links_and_effects_are_those_of_the_base_regressor():
    model = panda()
    arm, values = compile(model), motion(64, n=7)
    signals = {"dead_zone": np.full(7, 0.2)}
    joined = np.zeros((64, 7, model.base.count))
    for name, is_link in (("base_links", True), ("base_effects", False)):
        blocks = arm.base_blocks(*values, part=name, size=64, **signals)
        joints = blocks.evaluate(0, 64, blocks.buffer())
        for i, (columns, block) in enumerate(zip(blocks.columns, joints, strict=True)):
            assert np.all((model.base.kept[columns] < 70) == is_link)
            joined[:, i, columns] = block.T
    np.testing.assert_array_equal(joined, arm.base_regressor(*values, **signals))


def test_only_effects_are_evaluated_where_the_links_columns_are_known(monkeypatch):
    robot, stores = lieid.robots.two_link(), [{}]
    q, dq, ddq = motion(400)
    recording = lieid.Recording.from_arrays(np.arange(400) * 0.01, q, dq, 0.0 * q, ddq=ddq)
    segments = process(recording, lieid.Processing(cutoff=5.0, trim=0.1))
    Design(compile(lieid.Model(robot, "coulomb")), segments, known=stores)
    made = Compiled.base_blocks

    def base_blocks(self, *args, part, **options):
        blocks = made(self, *args, part=part, **options)
        if part == "base_links":
            monkeypatch.setattr(blocks, "evaluate", None)
        return blocks

    monkeypatch.setattr(Compiled, "base_blocks", base_blocks)
    larger = compile(lieid.Model(robot, "coulomb,viscous"))
    found = Design(larger, segments, known=stores).rows(np.zeros(0), None)
    monkeypatch.undo()
    whole = Design(larger, segments).rows(np.zeros(0), None)
    for own, expected in zip(found.joints, whole.joints, strict=True):
        np.testing.assert_array_equal(own.matrix, expected.matrix)
