"""The model's effects on the selected joint, and what the diagnosis found."""

from __future__ import annotations

from markupsafe import Markup
from nicegui import ui

from lieid_casadi.effects import Effect
from lieid_casadi.effects.description import describe, formula_html
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.plot_style import BACKWARD, FORWARD
from lieid_casadi.tables import figures
from lieid_casadi.workbench.elements import (
    Parts,
    View,
    button,
    cut_part,
    icon_part,
    named,
    part,
    place,
    set_text,
)
from lieid_casadi.workbench.evaluation import EffectCurve, EffectRow
from lieid_casadi.workbench.session import FoundEffects, ProposedEffect
from lieid_casadi.workbench.workbench import Workbench

WIDTH, HEIGHT, MARGIN = 270.0, 50.0, 4.0  # of the picture of an effect
MOST_VALUES = 6  # of an effect that are listed
STATUS = {"named": "named", "one_of": "one of", "shape": "shape"}
STATUS_MEANING = {
    "named": "the data separate this effect from every other kind of effect",
    "one_of": "this effect, or a rival beside it: the error falls, and the name is not certain",
    "shape": "no effect of the library describes it; a smooth function does",
}
#: Kinds of the library's effects, in the order of the menu; others are listed last.
KINDS = {
    "Friction": (
        "coulomb", "viscous", "offset", "stribeck", "load_friction", "presliding",
        "position_friction", "temperature_friction", "warm_up", "viscous_polynomial",
        "viscous_asymmetric",
    ),
    "Transmission": (
        "armature", "transmission_coupling", "joint_elasticity", "torque_ripple", "backlash",
        "position_spring",
    ),
    "Torque signal": (
        "torque_gain", "torque_delay", "time_shift", "torque_lowpass", "bias_drift",
    ),
    "Mounting and load": ("payload", "external_wrench", "base_tilt", "encoder_offset"),
    "Position-controlled drive": (
        "command_delay", "back_emf", "torque_saturation", "deadband",
    ),
    "Any shape": ("smooth",),
}  # fmt: skip


class EffectsView(View):
    """Effects of the model: formula, values, torque, a button that removes each, and a menu."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center no-wrap gap-1"):
                self._title = named(ui.label("Effects of the model"), "effects-title")
                self._title.classes("panel-title grow")
                self._menu = _EffectMenu(workbench)
            self._list = Parts("scroll tall", self._remove)

    async def _remove(self, label: str) -> None:
        await self.workbench.apply(self.workbench.session.without_effect(label))

    def update(self) -> None:
        """Show the effects of the current model on the selected joint."""
        workbench = self.workbench
        evaluation, joint, curves = workbench.evaluation, workbench.session.joint, workbench.curves
        if evaluation is None or not self.is_new(evaluation, joint, curves):
            return
        set_text(self._title, f"Effects on joint {joint + 1}")
        here = [row for row in evaluation.effects if row.joint == joint]
        here += [row for row in evaluation.effects if row.joint is None]
        others = [row for row in evaluation.effects if row.joint not in (joint, None)]
        opened = workbench.opened
        unit = "" if opened is None else opened.units[joint]
        shown = [_card(row, curves.get(row.label), unit) for row in here]
        if others:
            shown.append(part("muted small", "on other joints"))
            shown.append(part("chips", *map(_chip, others)))
        self._list.show(*shown)


class _EffectMenu:
    """The effects of the library, by kind, with a field to search them."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self.button = button("Add an effect", "add-effect", self._fill, "outline size=sm icon=add")
        with self.button, ui.menu().props("transition-duration=0 no-focus") as self._menu:
            self._search = ui.input("search").props("dense autofocus").classes("effect-search")
            named(self._search, "search-effect").on_value_change(self._fill)
            self._list = Parts("effect-menu", self._add)

    def _fill(self) -> None:
        """List the effects whose name, kind or description has the words that are searched."""
        words = str(self._search.value or "").lower().split()
        known = [name for names in KINDS.values() for name in names]
        plain = [name for name in REGISTER if "/" not in name]
        groups = {**KINDS, "Others": tuple(name for name in plain if name not in known)}
        shown: list[Markup] = []
        for kind, names in groups.items():
            rows = [(name, _one_line(make(name))) for name in names if name in REGISTER]
            rows = [r for r in rows if all(w in f"{kind} {' '.join(r)}".lower() for w in words)]
            if rows:
                shown.append(part("menu-kind", kind))
            shown += [
                part(
                    "menu-row", part("strong", name), cut_part("muted small grow ellipsis", line),
                    part("formula", Markup(formula_html(make(name).formula))),
                    id=f"library-{name}", action=name,
                )
                for name, line in rows
            ]  # fmt: skip
        self._list.show(*shown)

    async def _add(self, name: str) -> None:
        """Add an effect of the library to the selected joint."""
        session, opened = self._workbench.session, self._workbench.opened
        if session.step is None or opened is None:
            return
        self._menu.close()
        number, last = session.joint + 1, len(opened.joint_names)
        label = name if make(name).whole_arm else f"{name}:{number}"
        if make(name).couples:  # from the next joint, or the previous one of the last joint
            label = f"{name}:{number}<{number + 1 if number < last else number - 1}"
        await self._workbench.apply(session.with_added(label))


def _one_line(effect: Effect) -> str:
    """Return the first line of the description of an effect, else its formula."""
    line = (type(effect).__doc__ or "").strip().split("\n")[0] or effect.formula
    return line.replace("`", "").partition(": τ")[0].rstrip(".")


def _card(row: EffectRow, curve: EffectCurve | None, unit: str) -> Markup:
    """Return an effect with its values, and its torque once it is computed."""
    shown = [
        part(
            "card-head", part("strong grow", row.label), _atlas(row.label), _remove(row.label)
        ),
        part("formula", Markup(formula_html(row.effect.formula))),
        cut_part("muted small ellipsis", _one_line(row.effect)),
        *(part("value", value) for value in row.values[:MOST_VALUES]),
    ]  # fmt: skip
    if len(row.values) > MOST_VALUES:
        more = f"and {len(row.values) - MOST_VALUES} more"
        shown.append(part("value muted", more, tip="; ".join(row.values)))
    if curve is not None:
        shown.append(_curve_svg(curve, unit))
    shown.append(_facts(row.effect))
    return part("card", *shown, id=f"effect-{place(row.label)}")


def _facts(effect: Effect) -> Markup:
    """Return what reveals an effect, and what it can be confused with, behind a click."""
    rivals = ", ".join(effect.confused_with)
    title = f"can be confused with {rivals}" if rivals else "description"
    facts = (f for f in describe(effect) if f[0] not in ("formula", "signals"))
    rows = Markup().join(Markup("<dt>{}</dt><dd>{}</dd>").format(*fact) for fact in facts)
    summary = part("ellipsis", title, tip=f"{title}; lieid effects {effect.name} prints this")
    return Markup('<details class="facts small"><summary>{}</summary><dl>{}</dl></details>').format(
        summary, rows
    )


def _atlas(label: str) -> Markup:
    """Return a link to the page of an effect in the atlas."""
    effect = label.partition(":")[0]
    link = '<a class="material-icons icon-part" href="/atlas/{0}" target="_blank" title="{1}"'
    link += ' aria-label="{1}" data-testid="atlas-{2}">menu_book</a>'
    return Markup(link).format(effect, f"{effect} in the effect atlas", place(label))


def _chip(row: EffectRow) -> Markup:
    """Return an effect on another joint."""
    tip = "; ".join(row.values)
    return part("chip", row.label, _remove(row.label), id=f"effect-{place(row.label)}", tip=tip)


def _remove(label: str) -> Markup:
    return icon_part("close", label, f"remove {label} and fit again", id=f"remove-{place(label)}")


def _curve_svg(curve: EffectCurve, unit: str) -> Markup:
    """Return a picture of an effect's torque over its signal, with the ranges of both axes."""
    xs, ys = curve.signal, curve.torque
    low, high = min(xs), max(xs)
    most = max(max(abs(y) for y in ys), 1e-12)
    names = {"dq": "speed", "ddq": "acceleration", "q": "angle"}
    across, down = WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN
    points = "".join(
        f'<circle cx="{MARGIN + across * (x - low) / (high - low or 1.0):.1f}" '
        f'cy="{MARGIN + down * (0.5 - 0.5 * y / most):.1f}" r="1.4" '
        f'fill="{FORWARD if y >= 0.0 else BACKWARD}"/>'
        for x, y in zip(xs, ys, strict=True)
    )
    middle = MARGIN + 0.5 * down
    ranges = (
        f"± {figures(most)} {unit} over {names.get(curve.name, curve.name)} "
        f"{figures(low)} to {figures(high)} {curve.unit}"
    )
    return Markup(
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="100%" role="img" '
        f'aria-label="{ranges}">'
        f'<line x1="0" x2="{WIDTH:.0f}" y1="{middle:.1f}" y2="{middle:.1f}" stroke="#c8ced4"/>'
        f"{points}</svg>"
    ) + part("value muted", ranges)


class FindingsView(View):
    """The verdict, and what the diagnosis found: one line and one button each."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.row().classes("verdict-panel w-full no-wrap"):
            with named(ui.column(), "verdict").classes("grow gap-0") as self._whole:
                self._verdict = ui.label("").classes("verdict")
                self._list = Parts("findings", self._add)
            self._all = button("", "add-all", self._add_all, "unelevated color=primary")

    async def _add_all(self) -> None:
        found = self.workbench.session.found
        await self.workbench.add_found([p.label for p in found.proposed] if found else [])

    async def _add(self, action: str) -> None:
        """Add a proposal or a rival, or the proposals of a group."""
        found = self.workbench.session.found
        kind, _, name = action.partition(" ")
        several = found.groups.get(int(name), []) if found and kind == "group" else []
        labels = [each.label for each in several] if kind == "group" else [name]
        await self.workbench.add_found(labels)

    def update(self) -> None:
        """Show what was found, or what the running search has found so far."""
        workbench = self.workbench
        session, evaluation = workbench.session, workbench.evaluation
        found, step, searching = session.found, session.step, workbench.searching is not None
        if found is not None and step is not None and found.effects == step.effects:
            self._verdict.text = found.summary or found.sentence
        elif evaluation is not None:
            exact = "" if evaluation.exact else "\nPreliminary; the exact fit is computed."
            self._verdict.text = evaluation.sentence + exact
        if evaluation is not None:  # for tests and the benchmark of the latency
            self._whole.props["data-complete"] = str(evaluation.complete).lower()
        present = () if step is None else step.effects
        missing = [] if found is None else [p for p in found.proposed if p.label not in present]
        self._all.text = f"Add all {len(missing)}" if len(missing) > 1 else "Add it"
        self._all.set_visibility(bool(missing) and not searching)
        self._list.element.classes(replace=f"parts findings {'' if missing else 'added'}")
        if self.is_new(found, present, searching):
            shown = None if searching else found
            self._list.show(*(_findings(shown, session.error_name, present) if shown else ()))


def _findings(found: FoundEffects, kind: str, present: tuple[str, ...]) -> list[Markup]:
    shown = []
    for group in dict.fromkeys(p.group for p in found.proposed):
        several = found.groups.get(group, [])
        if any(p.label not in present for p in several):
            shown.append(_group_row(group, several))
        for proposed in (p for p in found.proposed if p.group == group):
            shown.append(_finding(proposed, kind, present=proposed.label in present))
            if proposed.rivals:
                shown.append(_rivals(proposed))
    return shown + [cut_part("value muted", sentence) for sentence in found.unexplained]


def _group_row(group: int, members: list[ProposedEffect]) -> Markup:
    """Return the effect that a group has on several joints; a click adds it on all of them."""
    joints = ", ".join(str(j) for j in sorted({j for each in members for j in each.joints}))
    return part(
        "finding group-row",
        cut_part("strong grow ellipsis", f"{members[0].effect} on joints {joints}"),
        part("part-button", f"Add on {len(members)} joints", id=f"add-group-{group}",
             action=f"group {group}"),
    )  # fmt: skip


def _finding(proposed: ProposedEffect, kind: str, *, present: bool) -> Markup:
    """Return a proposal in one line, with its errors of a ``kind``; a click adds it."""
    label, before, after = proposed.label, proposed.before, proposed.after
    shown = [
        part("strong", label),
        part(
            f"status {proposed.status}", STATUS[proposed.status], id=f"status-{place(label)}",
            tip=STATUS_MEANING[proposed.status],
        ),
        _atlas(label),
        part("grow muted", proposed.sentence or proposed.value),
    ]  # fmt: skip
    if before and after is not None:
        change = f"{100.0 * (after / before - 1.0):+z.0f} %"
        errors = f"{kind} {figures(before)} → {figures(after)} N·m ({change})"
        tip = "unseen error of the joint: with all that was found but this, and with all"
        shown.append(part("number", errors, tip=tip))
    action = "" if present else f"effect {label}"
    if present:
        shown.append(part("muted small", "in the model"))
    else:
        shown.append(part("material-icons add", "add_circle", tip="add it and fit again"))
    return part("finding candidate", *shown, id=f"candidate-{place(label)}", action=action)


def _rivals(proposed: ProposedEffect) -> Markup:
    """Return the rivals of a proposal; a click on one adds it in place of the proposal."""
    meanings = {"exact": "equivalent with any data", "data": "not separable by this data"}
    chips = [
        part("chip", label, id=f"candidate-{place(label)}", tip=meanings[kind],
             action=f"effect {label}")
        for label, kind in proposed.rivals
    ]  # fmt: skip
    return part("chips rivals", part("muted small", "or"), *chips)
