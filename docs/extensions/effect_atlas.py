"""Write the effect atlas: a page for each effect, from its definition and the simulated arm."""

import inspect
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant, plot_style
from lieid_casadi.effects import LIBRARY
from lieid_casadi.effects.description import formula_html
from lieid_casadi.effects.registry import make

ROBOT, RATE, DURATION = "panda", 100.0, 20.0
JOINT = 1  # joint 2 carries most of the load
ABSORBED = 1.05  # residual without the effect over residual with it: below it nothing shows
PER_RECORDING = ("bias_drift",)  # their values hold for the recording of the fit alone
HIDDEN = {"smooth": "stribeck"}  # what the arm has where an effect only describes others
BASE = ("coulomb", "viscous", "offset")
FORWARD, BACKWARD = plot_style.FORWARD, plot_style.BACKWARD


@dataclass(frozen=True)
class Trial:
    """An arm with an effect and the same arm without it, along one motion that was not fitted."""

    effects: tuple
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    load: np.ndarray
    moving: np.ndarray
    without: object
    with_it: object
    value: str
    error: float
    kept: bool


def registered(kind):
    """Return the effect with each of its options, the plain one first."""
    found = [make("/".join([kind.name, option]).rstrip("/")) for option in ("", *kind.options)]
    return list({effect.label: effect for effect in found}.values())


def arms(name):
    """Return the simulated arm with an effect, the same without it, and the models to compare."""
    robot = lieid.Robot.load(ROBOT)
    bare = plant.demo_arm(robot, hidden=None)
    friction, model = bare.friction, list(BASE)
    if name in BASE:
        values = getattr(friction, name).copy()
        values[JOINT] = 0.0
        others = "+".join(str(j + 1) for j in range(robot.n) if j != JOINT)
        model[BASE.index(name)] = f"{name}:{others}"
        return bare, replace(bare, friction=replace(friction, **{name: values})), model
    hidden = plant.hidden_effect(bare, HIDDEN.get(name, name), JOINT)
    thermal = plant.Thermal(rise=12.0, time_constant=20.0)
    bare = replace(bare, thermal=thermal) if name == "temperature_friction" else bare
    return bare.with_effects(hidden), bare, model


def where(effect, arm):
    """Return the specification that places an effect where the arm has it."""
    if effect.whole_arm:
        return effect.name
    for hidden in arm.effects:
        if hasattr(hidden, "source"):
            return f"{effect.name}:{JOINT + 1}<{hidden.source + 1}"
    return f"{effect.name}:{JOINT + 1}"


def run(effect):
    """Measure, fit without and with the effect, and compare on another motion."""
    arm, bare, base = arms(effect.name)
    warm = effect.name == "temperature_friction"
    sensors = replace(plant.demo_sensors(arm.robot, rate=RATE), temperature=warm)
    t = np.arange(0.0, DURATION, 2e-3)
    motions = [
        plant.FourierTrajectory(arm.robot, base_frequency=1 / DURATION, seed=seed).at(t)
        for seed in (1, 2)
    ]
    train, test = (
        plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed)
        for seed, motion in enumerate(motions)
    )
    exact = plant.measure_along(arm, t, *motions[1])
    velocity = np.gradient(exact.q, t, axis=0, edge_order=2)
    acceleration = np.gradient(velocity, t, axis=0, edge_order=2)
    reference = plant.move_along(bare, t, exact.q, velocity, acceleration)
    if effect.name in PER_RECORDING:
        test = train
    joint = strongest(exact.tau - reference.tau)
    full_fit = lieid.identify(lieid.Model(arm.robot, [*base, where(effect, arm)]), train)
    with_it = lieid.compare(full_fit, test)
    without = lieid.compare(lieid.identify(lieid.Model(arm.robot, base), train), test)
    error = (full_fit.rms_train if test is train else with_it.rms_moving)[joint]
    kept = without.rms_moving[joint] < ABSORBED * error
    if kept:
        earlier = plant.measure_along(bare, t, *motions[0], sensors=sensors, seed=3)
        without = lieid.compare(lieid.identify(lieid.Model(arm.robot, base), earlier), test)
    return joint, Trial(
        tuple(base), t, exact.q, velocity, exact.tau - reference.tau, reference.rigid,
        ~reference.resting, without, with_it, values_text(full_fit, effect), error, kept,
    )  # fmt: skip


def strongest(torque):
    """Return the joint where an effect on the whole arm is largest; else the joint it acts on."""
    rms = np.sqrt(np.mean(torque**2, axis=0))
    return JOINT if rms[JOINT] > 0.3 * rms.max() else int(np.argmax(rms))


def values_text(fit, effect):
    """Return the identified values of an effect with their standard deviations."""
    texts = []
    for row in fit.parameter_table():
        if not row["name"].startswith(effect.label + ".") or row["joint"] not in (None, JOINT + 1):
            continue
        name = row["name"].partition(".")[2].partition(":")[0] or row["name"]
        std = "" if row["std"] is None else f" ± {row['std']:.2g}"
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        texts.append(f"{name} = {row['value']:.3g}{std}{unit}")
    return ", ".join(texts)


def draw(trial, joint, path):
    """Draw the effect's torque and the residual that it leaves over angle, speed, load, time."""
    figure = plot_style.new_figure(10.0, 5.0)
    axes = figure.subplots(2, 4, sharey="row")
    series = trial.without.series[0]
    above = (trial.q, trial.dq, trial.load, trial.t[:, None].repeat(trial.q.shape[1], 1))
    below = (series.q, series.dq, series.load, series.time[:, None].repeat(series.q.shape[1], 1))
    names = ("angle q, rad", "speed q̇, rad/s", "load τ_load, N·m", "time, s")
    for column, (x, r, name) in enumerate(zip(above, below, names, strict=True)):
        scatter(axes[0, column], x[::10, joint], trial.torque[::10, joint], trial.dq[::10, joint])
        moving = series.moving[:, joint]
        error, sign = series.error[moving, joint], series.sign[moving, joint]
        scatter(axes[1, column], r[moving, joint], error, sign)
        axes[1, column].set_xlabel(name, fontsize=plot_style.NORMAL)
        floor = trial.without.noise_floor[joint]
        axes[1, column].axhspan(-floor, floor, color=plot_style.NOISE, linewidth=0, zorder=0.5)
    axes[0, 0].set_ylabel("torque of the effect, N·m", fontsize=plot_style.NORMAL)
    axes[1, 0].set_ylabel("residual without it, N·m", fontsize=plot_style.NORMAL)
    low, high = np.percentile(trial.without.series[0].error[:, joint], [0.2, 99.8])
    margin = 0.15 * (high - low)
    axes[1, 0].set_ylim(low - margin, high + margin)
    figure.savefig(path, dpi=130)


def scatter(ax, x, y, sign):
    """Draw points coloured by the direction of motion."""
    plot_style.style(ax)
    for way, colour in ((sign > 0, FORWARD), (sign < 0, BACKWARD)):
        ax.plot(x[way], y[way], ".", markersize=2.0, color=colour, alpha=0.6)


def page(kind, joint, trial):
    """Return the page of one effect as Markdown; the picture leads."""
    lines = [f"# {kind.name}", "", f"<p class='formula'>{formula_html(kind().formula)}</p>", ""]
    lines += [*docstring(kind), "", *trial_section(kind, joint, trial)]
    lines += ["## Terms", "", "| effect | term | option |", "| --- | --- | --- |"]
    for each in registered(kind):
        meaning = kind.options.get(each.option, "none")
        lines.append(f"| `{each.label}` | {rendered(each.formula)} | {cell(meaning)} |")
    lines += ["", *parameters(kind), *facts(kind())]
    lines += ["## Use", "", *use(kind()), ""]
    return "\n".join(lines)


def trial_section(kind, joint, trial):
    """Return the section with the picture; a link for effects of position-controlled drives."""
    if trial is None:
        text = "Recordings with commanded positions show it: see [position control](%s)."
        return ["## Torque and residual", "", text % "../guides/position_control.md", ""]
    picture = f"![Torque of {kind.name} and residual without it](pictures/{kind.name}.png)"
    return ["## Torque and residual", "", picture_text(kind, joint, trial), "", picture, ""]


def docstring(kind):
    """Return an effect's docstring without its sections, as Markdown."""
    text = inspect.cleandoc(kind.__doc__ or "").split("\nOptions\n-----")[0]
    lines = text.split("\nNotes\n-----")[0].replace("``", "`").splitlines()
    return [line if line.startswith("    ") else re.sub(r"([*|])", r"\\\1", line) for line in lines]


def rendered(formula):
    """Return a formula with subscripts and exponents for a cell of a Markdown table."""
    return formula_html(formula).replace("|", "&#124;")


def cell(text):
    """Return text that can stand in a cell of a Markdown table."""
    for character in "|*_^":
        text = text.replace(character, "\\" + character)
    return text


def parameters(kind):
    """Return the table of an effect's coefficients and shape parameters."""
    lines = ["## Parameters", "", "| effect | name | unit | meaning | range |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    for effect in registered(kind):
        for one in effect.coefficients:
            lower = "" if not np.isfinite(one.lower) else f"≥ {one.lower:g}"
            cells = (f"`{effect.label}`", cell(one.name), one.unit, cell(one.meaning), lower)
            lines.append("| " + " | ".join(cells) + " |")
        for shape in effect.shapes:
            bounds = f"{shape.lower:g} to {shape.upper:g}"
            meaning = f"{cell(shape.meaning)} (shape parameter)"
            cells = (f"`{effect.label}`", cell(shape.name), shape.unit, meaning, bounds)
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


def facts(effect):
    """Return what the definition states about use: motion, confusion, sizes, references."""
    lines = []
    if effect.revealed_by:
        lines += ["**Revealed by:** " + cell(effect.revealed_by) + ".", ""]
    if effect.typical:
        lines += ["**Typical sizes:** " + cell(effect.typical) + ".", ""]
    if effect.replaces:
        lines += ["**Takes the place of:** " + links(effect.replaces) + ".", ""]
    if effect.accompanied_by:
        lines += ["**Changes together with:** " + links(effect.accompanied_by) + ".", ""]
    if effect.confused_with:
        lines += ["## Confused with", "", "| effect | when, and how to separate them |"]
        lines += ["| --- | --- |"]
        for name, when in effect.confused_with.items():
            lines.append(f"| {links([name])} | {cell(when)} |")
        lines.append("")
    if effect.references:
        lines += ["## References", "", *(f"- {cell(text)}" for text in effect.references), ""]
    return lines


def links(names):
    """Return effects' names as links to their pages."""
    pages = {kind.name for kind in LIBRARY}
    texts = [f"[`{n}`]({n.split('/')[0]}.md)" if n.split("/")[0] in pages else n for n in names]
    return ", ".join(texts)


def use(effect):
    """Return how the effect is written on the command line."""
    spec = effect.name if effect.whole_arm else f"{effect.name}:2"
    spec = f"{effect.name}:2<3" if effect.couples else spec
    effects = ",".join([*(name for name in BASE if name != effect.name), spec])
    return [
        "```sh",
        f"lieid effects {effect.name}",
        f"lieid identify arm.urdf run1.csv --effects {effects} -o fit.json",
        "```",
        "",
        "```{eval-rst}",
        f"Class: :py:class:`{type(effect).__module__}.{type(effect).__qualname__}`",
        "```",
    ]


def picture_text(kind, joint, trial):
    """Return the sentences above the picture."""
    without, with_it = trial.without.rms_moving[joint], trial.error
    size = np.sqrt(np.mean(trial.torque[trial.moving[:, joint], joint] ** 2))
    motion = "the motion of the fit" if kind.name in PER_RECORDING else "a motion not in the fit"
    model = f"`{','.join(trial.effects)}`"
    sentences = [
        f"Simulated Panda, joint {joint + 1}, {DURATION:g} s of {motion}. RMS of the effect's "
        f"torque: {size:.3g} N·m."
    ]
    if kind.name in HIDDEN:
        sentences.append(f"The arm has `{HIDDEN[kind.name]}`, which this effect describes.")
    if trial.kept:
        sentences.append(
            f"**Absorbed**: a fit of {model} that includes this effect's recording has the same "
            f"residual with and without `{kind.name}` ({with_it:.3g} N·m), because the link "
            "parameters take it up. It shows where a fit is kept, as `lieid diagnose FIT REC` "
            f"does: a fit made before the effect appeared leaves {without:.3g} N·m, the residual "
            "in the picture."
        )
    else:
        sentences.append(
            f"RMS of the residual in motion: {without:.3g} N·m for the model {model}, "
            f"{with_it:.3g} N·m with `{kind.name}` added (noise floor at least "
            f"{trial.with_it.noise_floor[joint]:.3g} N·m). Identified: {trial.value}."
        )
    sentences.append(
        "Above: torque of the effect. Below: measured minus predicted torque of the model "
        "without the effect; the grey band is the noise floor. Blue: positive velocity, "
        "orange: negative velocity."
    )
    return " ".join(sentences)


def write(app):
    """Write effects/NAME.md, its picture, and the index."""
    folder = Path(app.srcdir, "effects")
    pictures = folder / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    for kind in LIBRARY:
        joint, trial = (JOINT, None) if kind.commanded else run(kind())
        if trial is not None:
            draw(trial, joint, pictures / f"{kind.name}.png")
        (folder / f"{kind.name}.md").write_text(page(kind, joint, trial), "utf-8")
    (folder / "index.md").write_text(index(), "utf-8")


def index():
    """Return the page that lists all effects."""
    lines = [
        "# Effect atlas", "",
        "Each effect is a term that is added to the rigid-body torque. The pages are generated "
        "from the definitions that fits, predictions, diagnosis and exported C use. The pictures "
        "come from the simulated arm (`lieid_casadi.plant`), which has its own definitions.", "",
        "| effect | term on joint i | |", "| --- | --- | --- |",
    ]  # fmt: skip
    for kind in LIBRARY:
        effect = kind()
        cells = (
            f"[{effect.name}]({kind.name}.md)",
            rendered(effect.formula),
            cell(docstring(kind)[0]),
        )
        lines.append("| " + " | ".join(cells) + " |")
    names = "\n".join(kind.name for kind in LIBRARY)
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", "", names, "```", ""])


def setup(app):
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
