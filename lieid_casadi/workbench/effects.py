"""The model's effects on the selected joint, and what the diagnosis found."""

from __future__ import annotations

from html import escape

from nicegui import ui

from lieid_casadi.comparison.plot_style import BACKWARD, FORWARD
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.workbench.elements import (
    View,
    acting,
    button,
    figures,
    icon_button,
    named,
    on_action,
    place,
    set_text,
    text,
)
from lieid_casadi.workbench.evaluation import EffectCurve, EffectRow
from lieid_casadi.workbench.session import FoundEffects, ProposedEffect
from lieid_casadi.workbench.workbench import Workbench

WIDTH, HEIGHT, MARGIN = 270.0, 62.0, 4.0  # of the picture of an effect
MOST_VALUES = 6  # of an effect that are listed
STATUS = {"named": "named", "one_of": "one of", "shape": "shape"}
STATUS_MEANING = {
    "named": "the data separate this effect from every other kind of effect",
    "one_of": "this effect, or one of the rivals beside it: the data do not separate them",
    "shape": "no effect of the library describes it; a smooth function does",
}
#: Kinds of the library's effects, in the order of the menu; others are listed last.
KINDS = {
    "Friction": (
        "coulomb", "viscous", "offset", "stribeck", "load_friction", "presliding",
        "position_friction", "temperature_friction", "warm_up", "viscous_polynomial",
        "viscous_asymmetric", "sigmoid_friction",
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
            self._list = ui.column().classes("w-full gap-1 scroll tall")
        on_action(self._list, self._remove)

    async def _remove(self, label: str) -> None:
        await self.workbench.apply(self.workbench.session.without_effect(label))

    def update(self) -> None:
        """Show the effects of the current model on the selected joint."""
        workbench = self.workbench
        evaluation, joint, curves = workbench.evaluation, workbench.session.joint, workbench.curves
        if evaluation is None or not self.is_new(evaluation, joint, curves):
            return
        set_text(self._title, f"Effects on joint {joint + 1}")
        removable = workbench.session.inputs.mode == "missing"
        self._menu.button.set_visibility(removable)
        self._list.clear()
        with self._list:
            for row in sorted(evaluation.effects, key=lambda row: row.joint != joint):
                if row.joint in (joint, None):
                    _effect_card(row, curves.get(row.label), self._unit(row), removable=removable)
            others = [row for row in evaluation.effects if row.joint not in (joint, None)]
            _other_joints(others, removable=removable)

    def _unit(self, row: EffectRow) -> str:
        """Return the unit of the torque of an effect."""
        opened = self.workbench.opened
        return "" if opened is None or row.joint is None else opened.units[row.joint]


class _EffectMenu:
    """The effects of the library, by kind, with a field to search them."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self.button = button("Add an effect", "add-effect", self._fill, "outline size=sm icon=add")
        with self.button, ui.menu().props("transition-duration=0 no-focus") as self._menu:
            self._search = ui.input("search").props("dense autofocus").classes("effect-search")
            named(self._search, "search-effect").on_value_change(self._fill)
            self._list = ui.column().classes("effect-menu gap-0")
        on_action(self._list, self._add)

    def _fill(self) -> None:
        """List the effects whose name, kind or description has the words that are searched."""
        words = str(self._search.value or "").lower().split()
        known = [name for names in KINDS.values() for name in names]
        plain = [name for name in REGISTER if "/" not in name]
        groups = {**KINDS, "Others": tuple(name for name in plain if name not in known)}
        self._list.clear()
        with self._list:
            for kind, names in groups.items():
                rows = [(name, _one_line(name)) for name in names if name in REGISTER]
                rows = [r for r in rows if all(w in f"{kind} {' '.join(r)}".lower() for w in words)]
                if rows:
                    ui.label(kind).classes("menu-kind")
                for name, line in rows:
                    row = acting(named(ui.row(), f"library-{name}").classes("menu-row"), name)
                    row.props["role"], row.props["tabindex"] = "button", "0"
                    with row:
                        ui.label(name).classes("strong")
                        text(line, "muted small grow ellipsis")

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
        await self._workbench.apply(session.with_effect(label))


def _one_line(name: str) -> str:
    """Return the first line of the description of an effect, else its formula."""
    effect = make(name)
    line = (type(effect).__doc__ or "").strip().split("\n")[0] or effect.formula
    return line.replace("`", "").rstrip(".")


def _effect_card(row: EffectRow, curve: EffectCurve | None, unit: str, *, removable: bool) -> None:
    """Show an effect with its values, and its torque once it is computed."""
    with named(ui.column(), f"effect-{place(row.label)}").classes("card"):
        with ui.row().classes("w-full items-center no-wrap gap-1"):
            ui.label(row.label).classes("strong grow")
            if removable:
                _remove_button(row.label, "size=sm")
        ui.label(row.formula).classes("formula")
        for value in row.values[:MOST_VALUES]:
            ui.label(value).classes("value")
        if len(row.values) > MOST_VALUES:
            more = text(f"and {len(row.values) - MOST_VALUES} more", "value muted")
            more.props["title"] = "; ".join(row.values)
        rivals = ", ".join(make(row.effect).confused_with)
        if rivals:
            text(f"can be confused with {rivals}", "muted small ellipsis w-full")
        if curve is not None:
            ui.html(_curve_svg(curve, unit), sanitize=False).classes("w-full")


def _other_joints(rows: list[EffectRow], *, removable: bool) -> None:
    """List the effects on other joints in one line each."""
    if not rows:
        return
    ui.label("on other joints").classes("muted small")
    with ui.row().classes("gap-1"):
        for row in rows:
            chip = ui.chip(row.label).props("dense outline square")
            named(chip, f"effect-{place(row.label)}").props["title"] = "; ".join(row.values)
            if removable:
                with chip:
                    _remove_button(row.label, "size=xs")


def _remove_button(label: str, look: str) -> ui.button:
    made = icon_button("close", f"remove-{place(label)}", f"remove {label} and fit again", look)
    return acting(made, label)


def _curve_svg(curve: EffectCurve, unit: str) -> str:
    """Return a picture of an effect's torque over its signal, with the ranges of both axes."""
    xs, ys = curve.signal, curve.torque
    low, high = min(xs), max(xs)
    most = max(max(abs(y) for y in ys), 1e-12)
    names = {"dq": "speed", "ddq": "acceleration", "q": "angle"}
    across, down = WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN - 12.0
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
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="100%" role="img" '
        f'aria-label="{escape(ranges)}">'
        f'<line x1="0" x2="{WIDTH:.0f}" y1="{middle:.1f}" y2="{middle:.1f}" stroke="#c8ced4"/>'
        f'{points}<text x="{MARGIN}" y="{HEIGHT - 3:.0f}" font-size="9.5" fill="#52606d">'
        f"{escape(ranges)}</text></svg>"
    )


class FindingsView(View):
    """The verdict, and what the diagnosis found: one line and one button each."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.row().classes("verdict-panel w-full no-wrap"):
            with named(ui.column(), "verdict").classes("grow gap-0") as self._whole:
                self._verdict = ui.label("").classes("verdict")
                self._list = ui.column().classes("w-full gap-0 findings")
            self._all = button("", "add-all", self._add_all, "unelevated color=primary")
        on_action(self._list, self._add)

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
        found, step = workbench.session.found, workbench.session.step
        arriving = [] if workbench.searching is None else workbench.arriving
        self._show_verdict()
        present = () if step is None else step.effects_and_changes
        missing = [] if found is None else [p for p in found.proposed if p.label not in present]
        searching = workbench.searching is not None
        self._all.text = f"Add all {len(missing)}" if len(missing) > 1 else "Add it"
        self._all.set_visibility(bool(missing) and not searching)
        if not self.is_new(id(found), present, searching, len(arriving)):
            return
        self._list.clear()
        with self._list:
            if searching:
                for proposal in arriving:
                    ui.label(
                        f"found: {proposal.label}, held-out error of joint {proposal.joint + 1} "
                        f"{figures(proposal.before)} → {figures(proposal.after)} N·m"
                    ).classes("value")
            elif found is not None:
                self._show(found, present)

    def _show_verdict(self) -> None:
        workbench = self.workbench
        session, evaluation = workbench.session, workbench.evaluation
        found, step = session.found, session.step
        if found is not None and step is not None and found.effects == step.effects:
            self._verdict.text = _summary(found)
        elif evaluation is not None:
            exact = "" if evaluation.exact else "\nPreliminary; the exact fit is computed."
            self._verdict.text = evaluation.sentence + exact
        if evaluation is not None:  # for tests and the benchmark of the latency
            props = self._whole.props
            props["data-complete"] = str(evaluation.complete).lower()
            props["data-seconds"] = f"{evaluation.seconds:.4f} {evaluation.cpu_seconds:.4f}"

    def _show(self, found: FoundEffects, present: tuple[str, ...]) -> None:
        changed = self.workbench.session.inputs.mode == "changed"
        for group in dict.fromkeys(p.group for p in found.proposed):
            members = [p for p in found.proposed if p.group == group]
            several = found.groups.get(group, [])
            if several and any(p.label not in present for p in several) and not changed:
                _group_row(group, several)
            for proposed in members:
                _finding(proposed, present=proposed.label in present, changed=changed)
        for sentence in found.unexplained:
            text(sentence, "value muted")


def _summary(found: FoundEffects) -> str:
    """Return the verdict in one sentence: what was found, and how far the error falls."""
    falls = [
        100.0 * (1.0 - after / before)
        for before, after in zip(found.path[0], found.path[-1], strict=True)
        if before and after is not None
    ] if len(found.path) > 1 else []  # fmt: skip
    if not found.proposed or not falls:
        return found.sentence
    count = len(found.proposed)
    if found.model:
        what = "One effect is missing" if count == 1 else f"{count} effects are missing"
        where = "on unseen motion"
    else:
        what = "One change since the fit" if count == 1 else f"{count} changes since the fit"
        where = "on the new recordings"
    least, most = (f"{max(fall, 0.0):.0f}" for fall in (min(falls), max(falls)))
    by = f"{most} %" if least == most else f"{least} to {most} %, depending on the joint"
    return f"{what}: with {'it' if count == 1 else 'them'} the error {where} falls by {by}."


def _group_row(group: int, members: list[ProposedEffect]) -> None:
    """Show the effect that a group has on several joints, and add it on all of them."""
    joints = ", ".join(str(j) for j in sorted({j for each in members for j in each.joints}))
    with ui.row().classes("finding group-row"):
        text(f"{members[0].effect} on joints {joints}", "strong grow ellipsis")
        made = named(ui.button(f"Add on {len(members)} joints"), f"add-group-{group}")
        acting(made.props("dense no-caps flat size=sm"), f"group {group}")


def _finding(proposed: ProposedEffect, *, present: bool, changed: bool) -> None:
    """Show a proposal in one line, with its rivals; a click adds it."""
    row = named(ui.row(), f"candidate-{place(proposed.label)}").classes("finding candidate")
    if not present:
        acting(row, f"effect {proposed.label}").props["role"] = "button"
        row.props["tabindex"] = "0"
    before, after = proposed.before, proposed.after
    facts = proposed.sentence or proposed.value
    with row:
        ui.label(proposed.label).classes("strong")
        status = named(ui.label(STATUS[proposed.status]), f"status-{place(proposed.label)}")
        status.classes(f"status {proposed.status}")
        status.props["title"] = STATUS_MEANING[proposed.status]
        text(f"change: {proposed.value}" if changed else facts, "grow ellipsis muted")
        if before and after is not None:
            change = f"{100.0 * (after / before - 1.0):+.0f} %"
            text(f"{figures(before)} → {figures(after)} N·m ({change})", "number").props[
                "title"
            ] = "unseen error of the joint without and with it"
        if proposed.selected is not None:
            found = text(f"{100.0 * proposed.selected:.0f} %", "number muted small")
            found.props["title"] = (
                "part of the searches, each without a part of the data, in which it was chosen"
            )
        if proposed.confirmed is False:
            text("not on the test", "small warning").props["title"] = (
                "the error on the test does not fall"
            )
        if present:
            ui.label("shown" if changed else "in the model").classes("muted small")
        else:
            ui.icon("add_circle").classes("add").props["title"] = "add it and fit again"
    if proposed.rivals and not changed:
        _rivals(proposed)


def _rivals(proposed: ProposedEffect) -> None:
    """Show the rivals of a proposal; a click on one adds it in place of the proposal."""
    with ui.row().classes("gap-1 items-center rivals"):
        ui.label("or").classes("muted small")
        for label, kind in proposed.rivals:
            chip = ui.chip(label).props("dense outline square clickable")
            exact = kind == "exact"
            chip.props["title"] = (
                "equivalent with any data" if exact else "not separable by this data"
            )
            named(acting(chip, f"effect {label}"), f"candidate-{place(label)}")
