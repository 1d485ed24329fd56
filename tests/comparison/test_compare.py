"""Results of a comparison against independent computations, and their plots."""

import io
import json
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from comparison import two_link_data as arm
from matplotlib.figure import Figure
from scipy.signal import butter, lfilter, sosfiltfilt

import lieid_casadi as lieid
from lieid_casadi import plant, plot_style
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.comparison.comparison import NUMBERS, verdict
from lieid_casadi.comparison.series import (
    residual_correlations,
    residual_spectrum,
    strongest_at,
)
from lieid_casadi.errors import (
    BeyondTrainingWarning,
    EffectError,
    ModelError,
    RecordingError,
    SameRecordingWarning,
)
from lieid_casadi.identification.recording_checks import Provenance, Source


@pytest.fixture(scope="module")
def fit():
    return arm.fit()


def white_through_filter(sigma, cutoff, *, samples=200_000):
    """Standard deviation of white noise after the low-pass, by simulation."""
    noise = sigma * np.random.default_rng(5).standard_normal(samples)
    return sosfiltfilt(butter(4, cutoff, fs=arm.RATE, output="sos"), noise).std()


def test_errors_are_those_of_the_torques(fit):
    test = arm.recording(14.0, seed=2, noise=0.3, still_after=9.0)
    error = test.tau - fit.predict(test)
    comparison = lieid.compare(fit, test)
    np.testing.assert_allclose(comparison.rms_raw, np.sqrt((error**2).mean(axis=0)), rtol=0.02)
    assert np.all(comparison.rms_raw > 2.0 * comparison.rms)
    both = zip(comparison.rms_moving, comparison.rms_at_rest, comparison.at_rest, strict=True)
    for rms, (moving, resting, part) in zip(comparison.rms, both, strict=True):
        assert rms**2 == pytest.approx((1 - part) * moving**2 + part * np.nan_to_num(resting) ** 2)
    assert 0.3 < comparison.at_rest[1] < 0.45  # 4.5 of 13 s
    content = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert content["rms_at_rest"][0] is None  # joint 1 never rests
    assert all(len(content[name]) == 2 for name in NUMBERS)
    assert len(content["recordings"][0]["sha256"]) == 64


@pytest.mark.parametrize(
    ("seconds", "source"),
    [(30.0, "period_to_period"), (10.0, "motion")],  # of a period of 6 s
)
def test_the_noise_floor_is_the_noise_that_was_added(fit, seconds, source):
    comparison = lieid.compare(fit, arm.recording(seconds, seed=1, noise=0.4))
    assert comparison.noise_source == source
    np.testing.assert_allclose(comparison.noise_floor, white_through_filter(0.4, 6.0), rtol=0.12)


def test_the_noise_floor_of_recordings_with_unlike_noise_is_that_of_all(fit):
    """The longer one is periodic and has little noise."""
    runs = [arm.recording(t, seed=1, noise=x) for t, x in ((30.0, 0.1), (10.0, 0.6))]
    mean = np.sqrt((29.0 * 0.1**2 + 9.0 * 0.6**2) / 38.0)
    floor = lieid.compare(fit, runs).noise_floor
    np.testing.assert_allclose(floor, white_through_filter(mean, 6.0), rtol=0.12)


def test_training_recordings_give_the_training_error():
    train = [arm.recording(20.0, seed=s, noise=0.2, name=f"run {s}") for s in (3, 4)]
    fit = arm.fit(*train)
    comparison = lieid.compare(fit, train)
    np.testing.assert_allclose(comparison.rms, fit.rms_train)
    np.testing.assert_allclose(comparison.rms_raw, fit.rms_train_raw)


def test_a_drift_is_that_of_the_training_recordings_alone():
    """Parts of one file are different recordings, although their hashes are equal."""
    t = arm.motion(20.0, seed=3)[0]
    drift = np.column_stack([0.5 * (t - t.mean()), np.zeros(len(t))])
    whole = arm.recording(20.0, seed=3, noise=0.2, extra=drift, name="run.csv")
    train, rest = whole.cut(0.0, 12.0), whole.cut(12.0, 20.0)
    fit = arm.fit(train, effects=f"{arm.EFFECTS},bias_drift:1")
    comparison = lieid.compare(fit, train)
    np.testing.assert_allclose(comparison.rms, fit.rms_train)
    assert np.all(comparison.over_noise < 1.2)
    (elsewhere,) = lieid.compare(fit, rest).series
    assert np.std(elsewhere.error[:, 0]) == pytest.approx(0.5 * 7.0 / np.sqrt(12.0), rel=0.05)


def test_a_part_is_itself_beside_others_that_overlap_with_it():
    parts = [Source(f"run.csv@{ends}", "one hash") for ends in ("0:12", "10:20", "11:13", "30:40")]
    provenance = Provenance("", tuple(parts[:2]))
    assert [provenance.number(part) for part in parts] == [0, 1, 0, None]


def test_the_drift_of_each_recording_has_its_own_rate(tmp_path):
    rates, train = (0.5, -0.3, 0.1), []
    for k, rate in enumerate(rates):
        t = arm.motion(12.0, seed=3 + k)[0]
        drift = np.column_stack([rate * (t - t.mean()), np.zeros(len(t))])
        train.append(arm.recording(12.0, seed=3 + k, noise=0.2, extra=drift, name=f"run {k}"))
    made = arm.fit(*train, effects=f"{arm.EFFECTS},bias_drift/3:1")
    made.save(tmp_path / "fit.json")
    fit = lieid.Fit.load(tmp_path / "fit.json")
    own = [r for r in fit.parameter_table() if r["name"].startswith("bias_drift")]
    for row, rate, recording in zip(own, rates, train, strict=True):
        assert abs(row["value"] - rate) < 4.0 * row["std"] < 0.1
        assert np.all(lieid.compare(fit, recording).over_noise < 1.2)
    np.testing.assert_allclose(lieid.compare(fit, train).rms, fit.rms_train)
    with pytest.raises(EffectError, match="found 4 recordings; use bias_drift/4"):
        lieid.identify(fit.model, [*train, arm.recording(12.0, seed=9)])
    with pytest.raises(EffectError, match="bias_drift/one: expected a number of recordings"):
        lieid.Model(fit.model.robot, "bias_drift/one")


def coloured(correlation_time, size, seed, samples):
    """Return noise (samples, 2) of first order with a correlation time, s."""
    random = np.random.default_rng(seed)
    memory = np.exp(-1.0 / (arm.RATE * correlation_time))
    white = random.standard_normal((samples, 2)) * size * np.sqrt(1.0 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


@pytest.mark.parametrize("correlation_time", [0.0, 0.3])
@pytest.mark.parametrize("missing", [False, True])
def test_noise_floor_of_white_and_coloured_noise(fit, correlation_time, missing):
    """The estimate is near the noise, and never above the error, whatever the model lacks."""
    ratios = []
    for seed in (11, 12):
        _, q, dq, _ = arm.motion(11.0, seed=seed)
        if correlation_time:
            noise = coloured(correlation_time, 0.3, seed, len(q))
        else:
            noise = 0.6 * np.random.default_rng(seed).standard_normal(q.shape)
        friction = 3.0 * np.sign(dq) * np.exp(-((dq / 0.1) ** 2)) + 2.0 * dq**3
        extra = noise + friction * missing
        noisy = lieid.compare(fit, arm.recording(11.0, seed=seed, extra=extra))
        pure = lieid.compare(fit, arm.recording(11.0, seed=seed, extra=friction * missing))
        errors = [a.error - b.error for a, b in zip(noisy.series, pure.series, strict=True)]
        ratios.append(noisy.noise_floor / np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
        assert np.all(noisy.noise_floor <= noisy.rms_moving)
        assert np.all(noisy.over_noise[:1] > 1.5) or not missing
    # slow noise at the frequencies of the motion is partly taken for an effect
    least = 0.5 if missing and correlation_time > 0.2 else 0.75
    assert np.all(np.mean(ratios, axis=0) > least)
    assert np.all(np.mean(ratios, axis=0) < 1.4)


@pytest.mark.parametrize(("step", "noise"), [(1, 1e-4), (4, 0.0)], ids=["noisy", "50 Hz"])
def test_reversals_that_positions_do_not_show_to_a_sample_are_no_missing_effect(step, noise):
    """Of a complete model: its error is up to 6 times the scatter between periods."""
    for seed in range(3):
        t, q, dq, ddq = arm.motion(24.0, seed=seed)
        random = np.random.default_rng(seed)
        tau = arm.torque(q, dq, ddq) + 0.05 * random.standard_normal(q.shape)
        seen = (q + noise * random.standard_normal(q.shape))[::step]
        run = lieid.Recording.from_arrays(t[::step], seen, tau=tau[::step])
        comparison = lieid.compare(arm.fit(run), run)
        assert comparison.noise_source == "period_to_period"
        assert np.all(comparison.over_noise < 1.5), comparison.over_noise


def test_slow_noise_and_uncertain_parameters_are_not_above_the_noise_floor():
    """Of a complete model, identified and compared with noise that is correlated over 0.5 s."""
    for seed in range(3):
        both = [
            arm.recording(12.0, seed=k, extra=coloured(0.5, 1.5, k, len(arm.motion(12.0)[0])))
            for k in (2 * seed, 2 * seed + 1)
        ]
        unseen = lieid.compare(arm.fit(both[0]), both[1])
        assert np.all(unseen.over_noise < 1.3), unseen.over_noise
        assert np.all(unseen.over_noise > 0.99)


@pytest.mark.parametrize(
    "missing",
    [
        lambda q, dq: 4.0 * q[:, 0],
        lambda q, dq: 4.0 * (q[:, 0] - q[:, 1]),
        lambda q, dq: 6.0 * dq[:, 0] * dq[:, 1],
    ],
    ids=["spring", "spring between joints", "product of velocities"],
)
def test_a_missing_effect_raises_the_error_and_not_the_noise(fit, missing):
    _, q, dq, _ = arm.motion(10.0, seed=1)
    extra = np.column_stack([missing(q, dq), np.zeros(len(q))])  # on joint 1
    without = lieid.compare(fit, arm.recording(10.0, seed=1, noise=0.4))
    comparison = lieid.compare(fit, arm.recording(10.0, seed=1, noise=0.4, extra=extra))
    np.testing.assert_allclose(comparison.noise_floor, without.noise_floor, rtol=0.1)
    assert comparison.over_noise[0] > 5.0
    assert comparison.over_noise[1] < 1.5
    assert "On joint 1 the error in motion is " in verdict(comparison)


def test_errors_of_parameters_are_no_missing_effect():
    """Of 56 joints of complete models of 15 s, on recordings that the fit did not use."""
    robot = lieid.robots.panda()
    simulated = plant.demo_arm(robot, seed=0, hidden=None)

    def noisy(seed):
        t = np.arange(0.0, 15.0, 1.0 / arm.RATE)
        motion = plant.FourierTrajectory(robot, base_frequency=1.0 / 15.0, seed=seed).at(t)
        run = plant.measure_along(simulated, t, *motion, sensors=plant.Sensors(rate=arm.RATE))
        memory = np.exp(-1.0 / (0.3 * arm.RATE))
        white = np.sqrt(1.0 - memory**2) * np.random.default_rng(seed).normal(size=run.tau.shape)
        noise = 0.02 * run.tau.std(axis=0) * lfilter([1.0], [1.0, -memory], white, axis=0)
        return replace(run, tau=run.tau + noise)

    model, processing = lieid.Model(robot, arm.EFFECTS), lieid.Processing(cutoff=5.0)
    above = 0
    for seed in range(0, 16, 2):
        trained = lieid.identify(model, noisy(seed), processing=processing)
        above += int(np.sum(lieid.compare(trained, noisy(seed + 1)).over_noise > 1.5))
    assert above <= 1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_slow_oscillation_with_time_is_no_noise(seed):
    """The motion has a period of 6 s, the oscillation of 13 s."""
    t = arm.motion(22.0)[0]
    hum = np.column_stack([np.sin(2.0 * np.pi * 1.7 * t / 22.0), np.zeros(len(t))])
    run = arm.recording(22.0, seed=seed, noise=0.3, extra=hum)
    comparison = lieid.compare(arm.fit(run), run)
    pure = white_through_filter(0.3, 6.0)
    assert np.all(comparison.noise_floor < [1.5 * pure, 1.2 * pure])
    assert comparison.over_noise[0] > 5.0
    assert comparison.over_noise[1] < 1.2


def test_noise_that_is_correlated_over_a_second_is_noise():
    """Of 40 joints in 15 s."""
    above = 0
    for seed in range(20):
        noise = coloured(1.0, 1.5, seed, len(arm.motion(15.0)[0]))
        run = arm.recording(15.0, seed=seed, extra=noise)
        above += int(np.sum(lieid.compare(arm.fit(run), run).over_noise > 1.5))
    assert above <= 2


def test_no_noise_floor_of_joints_at_rest(fit):
    comparison = lieid.compare(fit, arm.recording(10.0, seed=2, noise=0.2, still_after=0.0))
    assert np.isnan(comparison.noise_floor).tolist() == [False, True]
    assert comparison.to_dict()["noise_floor"][1] is None


def test_largest_errors_are_at_the_disturbances(fit):
    t = arm.motion(14.0)[0]
    pulse = np.zeros((len(t), 2))
    for joint, instant, size in ((0, 4.0, -30.0), (0, 9.0, 20.0), (1, 6.0, 15.0)):
        pulse[:, joint] += size * np.exp(-(((t - instant) / 0.1) ** 2))
    test = arm.recording(14.0, seed=2, noise=0.05, extra=pulse, name="disturbed")
    worst = lieid.compare(fit, test).worst
    first = [m for m in worst if m.joint == 0]
    assert [round(m.time, 1) for m in first[:2]] == [4.0, 9.0]
    assert first[0].error < -20.0
    assert first[1].error > 13.0
    assert next(round(m.time, 1) for m in worst if m.joint == 1) == 6.0
    assert all(abs(a.time - b.time) >= 1.0 for a in first for b in first if a is not b)
    assert {m.recording for m in worst} == {"disturbed"}
    assert worst[0].to_dict()["joint"] == 1


def test_error_at_rest_is_reported_for_the_joint_that_rests(fit):
    t = arm.motion(14.0)[0]
    stuck = np.where((t >= 7.0)[:, None], [0.0, 1.4], 0.0)  # static friction holds joint 2
    test = arm.recording(14.0, seed=2, noise=0.1, still_after=7.0, extra=stuck)
    comparison = lieid.compare(fit, test)
    assert "On joint 2 the error at rest" in verdict(comparison)
    assert comparison.rms_moving[1] < 0.3


@pytest.mark.parametrize(
    ("train", "test", "reported"),
    [
        ((0.0, 12.0), (12.0, 24.0), False),
        ((0.0, 12.0), (8.0, 20.0), True),
        ((0.0, 12.0), (None, None), True),
        ((None, 12.0), (11.0, None), True),
    ],
)
def test_testing_on_training_data_is_reported(tmp_path, train, test, reported):
    arm.recording(24.0, seed=3, noise=0.2).save(tmp_path / "run.npz")
    whole = lieid.Recording.load(tmp_path / "run.npz")
    part = whole if test == (None, None) else whole.cut(*test)
    comparison = lieid.compare(arm.fit(whole.cut(*train)), part)
    assert any(isinstance(w, SameRecordingWarning) for w in comparison.warnings) is reported


def test_motion_beyond_the_training_of_a_smooth_function_is_a_warning():
    model = lieid.Model(lieid.robots.two_link(), f"{arm.EFFECTS},smooth/q.dq:2")
    t, q, dq, ddq = arm.motion(24.0, seed=1)
    tau = arm.torque(q, dq, ddq)
    small = lieid.Recording.from_arrays(t, q / 4, dq / 4, arm.torque(q / 4, dq / 4, ddq / 4))
    whole = lieid.Recording.from_arrays(t, q, dq, tau)

    def beyond(train, test):
        found = lieid.compare(lieid.identify(model, train), test).warnings
        return [str(w) for w in found if isinstance(w, BeyondTrainingWarning)]

    (text,) = beyond(small, whole)
    part = float(text.partition(" %")[0]) / 100.0
    low, high = np.percentile(q[:, 1] / 4, [0.5, 99.5])
    fast = np.percentile(np.abs(dq[:, 1]) / 4, 99.5)
    outside = (q[:, 1] < low) | (q[:, 1] > high) | (np.abs(dq[:, 1]) > fast)
    assert part == pytest.approx(np.mean(outside), abs=0.03)
    assert "smooth/q.dq:2" in text
    assert not beyond(whole, small)


def test_recordings_that_cannot_be_compared_are_refused(fit):
    t, q, dq, ddq = arm.motion(12.0)
    with pytest.raises(ModelError, match="no torque; expected columns tau1…tau2"):
        lieid.compare(fit, lieid.Recording.from_arrays(t, q, dq))
    with pytest.raises(ModelError, match="1 joints"):
        lieid.compare(fit, lieid.Recording.from_arrays(t, q[:, :1], dq[:, :1], dq[:, :1]))
    with pytest.raises(RecordingError, match="too short"):
        lieid.compare(fit, arm.recording(1.0, seed=2))
    slow = slice(None, None, 25)  # 8 Hz, below what a filter of 6 Hz needs
    tau = arm.torque(q, dq, ddq)
    with pytest.raises(RecordingError, match="cutoff 6 Hz"):
        lieid.compare(fit, lieid.Recording.from_arrays(t[slow], q[slow], dq[slow], tau[slow]))
    with pytest.raises(lieid.LieidError, match="no recordings"):
        lieid.compare(fit, [])


def test_a_torque_of_zero_has_no_relative_error():
    t = np.arange(0.0, 12.0, 0.005)
    q = np.column_stack([np.sin(t), np.cos(2 * t)])
    comparison = lieid.compare(
        arm.fit(), lieid.Recording.from_arrays(t, q, None, np.zeros((len(t), 2)))
    )
    assert "the measured torque is zero" in verdict(comparison)
    assert comparison.to_dict()["relative_rms"] == [None, None]
    assert comparison.to_dict()["correlation"] == [None, None]


def test_series_contain_the_signals_of_the_plots(fit):
    test = arm.recording(12.0, seed=2, name="run")
    (series,) = lieid.compare(fit, test).series
    inside = slice(5, -5)
    at = lambda x: np.interp(series.time[inside], test.t, x)  # noqa: E731
    for j in range(2):
        np.testing.assert_allclose(series.q[inside, j], at(test.q[:, j]), atol=2e-3)
        np.testing.assert_allclose(series.dq[inside, j], at(test.dq[:, j]), atol=2e-2)
    assert set(np.unique(series.sign)) <= {-1.0, 0.0, 1.0}
    fast = np.abs(series.dq) > 0.2
    np.testing.assert_array_equal(series.sign[fast], np.sign(series.dq[fast]))
    # the load is the torque without friction
    _, q, dq, ddq = arm.motion(12.0, seed=2)
    rigid = arm.torque(q, dq, ddq) - np.sign(dq) * [3.0, 1.5] - dq * [2.0, 0.8]
    np.testing.assert_allclose(series.load[inside, 1], at(rigid[:, 1]), atol=0.25)


def test_the_error_of_a_complete_model_is_uncorrelated_noise(fit):
    """About one in a hundred values of white noise lies outside the bands."""
    outside = []
    for seed in range(5, 8):
        test = arm.recording(40.0, seed=seed, noise=0.3)
        segments = compared_segments(fit, [test])
        comparison = compare_segments(fit, [test], segments, with_noise=False)
        found = residual_correlations(comparison.series, 0, comparison.cutoff)
        outside += [np.abs(each.value[each.lag != 0.0]) > each.band for each in found]
    assert np.concatenate(outside[::3]).mean() < 0.04
    # neighbouring lags of a smooth signal lie outside together
    assert np.concatenate(outside[1::3] + outside[2::3]).mean() < 0.15


def test_a_missing_damping_correlates_with_the_speed_and_a_late_torque_with_its_past(fit):
    dq = arm.motion(30.0, seed=5)[2]
    missing = arm.recording(30.0, seed=5, noise=0.1, extra=1.5 * dq)
    comparison = lieid.compare(fit, missing)
    own, speed, acceleration = residual_correlations(comparison.series, 0, comparison.cutoff)
    assert own.value[1] > 5.0 * own.band
    assert speed.lag[np.argmax(speed.value)] == pytest.approx(0.0, abs=0.02)
    assert speed.value.max() > 0.9
    assert abs(acceleration.value[acceleration.lag == 0.0][0]) < 0.2
    lag = round(0.3 * arm.RATE)
    late = np.vstack([np.zeros((lag, 2)), dq[:-lag]])
    comparison = lieid.compare(fit, arm.recording(30.0, seed=5, noise=0.1, extra=1.5 * late))
    speed = residual_correlations(comparison.series, 0, comparison.cutoff)[1]
    assert speed.lag[np.argmax(speed.value)] == pytest.approx(0.3, abs=0.09)


def test_a_spectrum_has_the_power_of_the_error_and_a_peak_where_it_happens(fit):
    t = arm.motion(40.0, seed=5)[0]
    burst = 3.0 * np.sin(2.0 * np.pi * 4.0 * t) * (np.abs(t - 27.0) < 2.0)  # 4 Hz around 27 s
    extra = np.column_stack([burst, np.zeros(len(t))])
    comparison = lieid.compare(fit, arm.recording(40.0, seed=5, noise=0.1, extra=extra))
    frequency, amplitude = residual_spectrum(comparison.series, 0, comparison.cutoff)
    assert frequency[np.argmax(amplitude)] == pytest.approx(4.0, abs=0.15)
    assert np.sqrt(np.sum(amplitude**2)) == pytest.approx(comparison.rms[0], rel=0.2)
    assert strongest_at(comparison.series, 0, 4.0) == pytest.approx(27.0, abs=1.5)


@pytest.fixture(scope="module")
def drawn():
    test = arm.recording(14.0, seed=2, noise=0.2, still_after=10.0, name="run_$1$.csv")
    return lieid.compare(arm.fit(), test)


def png(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def test_plots_are_figures_and_change_no_setting(drawn):
    from matplotlib import pyplot

    before, windows = dict(matplotlib.rcParams), pyplot.get_fignums()
    figures = [drawn.plot(), drawn.plot(joint=1), drawn.plot_errors()]
    assert all(type(figure) is Figure for figure in figures)
    assert png(figures[1]).startswith(b"\x89PNG")
    figure = Figure()
    assert drawn.plot(figure.subplots(), joint=1) is figure
    assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == windows


def test_errors_are_drawn_against_each_signal(drawn):
    axes = np.reshape(drawn.plot_errors().axes, (2, 4))
    (series,) = drawn.series
    for joint in range(2):
        for column, signal in ((0, series.q), (1, series.dq), (2, series.load)):
            clouds = [line for line in axes[joint, column].get_lines() if line.get_marker() == "."]
            points = np.vstack([np.transpose(line.get_data()) for line in clouds])
            expected = np.column_stack([signal[:, joint], series.error[:, joint]])
            assert sorted(map(tuple, points)) == sorted(map(tuple, expected))


@pytest.mark.parametrize("names", [("$x^2", "\\frac {}"), ("ü" * 200, "")])
def test_any_name_can_be_drawn(drawn, names):
    floor = np.full(2, np.nan)  # is not drawn
    named = replace(drawn, joint_names=names, noise_floor=floor, noise_source="none")
    for figure in (named.plot(), named.plot_errors()):
        figure.set_layout_engine("none")  # texts are parsed without it too
        figure.draw_without_rendering()
        assert "noise" not in " ".join(t.get_text() for t in figure.legends[0].get_texts())


def test_decimated_lines_keep_their_peaks():
    x = np.arange(200_000.0)
    y = np.sin(x / 900.0)
    y[123_456], y[77_777] = 9.0, -7.0
    thin_x, thin_y = plot_style.envelope(x, y)
    assert len(thin_x) <= 2 * plot_style.MOST_COLUMNS
    assert thin_y.max() == 9.0
    assert thin_y.min() == -7.0
    assert np.all(np.diff(thin_x) > 0.0)
    np.testing.assert_array_equal(y[thin_x.astype(int)], thin_y)
