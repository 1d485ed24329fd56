"""The model's effects on the selected joint, and the effects that a diagnosis proposes."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from lieid_casadi.comparison.plot_style import BACKWARD, FORWARD
from lieid_casadi.effects.registry import REGISTER, make
from lieid_casadi.workbench.elements import acting, figures, named, on_action, place
from lieid_casadi.workbench.evaluation import EffectCurve, EffectRow
from lieid_casadi.workbench.session import ProposedEffect

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

WIDTH, HEIGHT, MARGIN = 270.0, 62.0, 4.0


def curve_svg(curve: EffectCurve, unit: str) -> str:
    """Return the torque of an effect over its signal; the texts are the ranges of both axes.

    Parameters
    ----------
    unit : str
        Of the torque.
    """
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
    text = (
        f"± {figures(most)} {unit} over {names.get(curve.name, curve.name)} "
        f"{figures(low)} to {figures(high)} {curve.unit}"
    )
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="100%" role="img" '
        f'aria-label="{escape(text)}">'
        f'<line x1="0" x2="{WIDTH:.0f}" y1="{middle:.1f}" y2="{middle:.1f}" stroke="#c8ced4"/>'
        f'{points}<text x="{MARGIN}" y="{HEIGHT - 3:.0f}" font-size="9.5" fill="#52606d">'
        f"{escape(text)}</text></svg>"
    )


class EffectsView:
    """Effects of the model: formula, values, and a button that removes each."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full grow-panel"):
            self._title = named(ui.label("Effects of the model"), "effects-title")
            self._title.classes("panel-title")
            self._list = ui.column().classes("w-full gap-1 scroll")
            self._library = ui.select(sorted(REGISTER), label="add an effect of the library")
            named(self._library.props("dense options-dense").classes("w-full"), "add-effect")
            self._library.on_value_change(self._add)
        on_action(self._list, self._remove)

    async def _remove(self, label: str) -> None:
        await self._workbench.apply(self._workbench.session.without_effect(label))

    async def _add(self, event: ValueChangeEventArguments[str | None]) -> None:
        """Add an effect of the library to the selected joint."""
        name, session = event.value, self._workbench.session
        if name is None or session.step is None:
            return
        self._library.value = None
        number = session.joint + 1
        if make(name).couples:  # from the next joint, or the previous one of the last joint
            assert self._workbench.opened is not None
            last = len(self._workbench.opened.joint_names)
            label = f"{name}:{number}<{number + 1 if number < last else number - 1}"
        else:
            label = name if make(name).whole_arm else f"{name}:{number}"
        await self._workbench.apply(session.with_effect(label))

    def update(self) -> None:
        """Show the effects of the current model on the selected joint."""
        evaluation, joint = self._workbench.evaluation, self._workbench.session.joint
        step = self._workbench.session.step
        if evaluation is None or step is None:
            return
        curves = self._workbench.details.curves(step)
        now = (evaluation, joint, curves)
        if self._shown == now:
            return
        self._shown = now
        self._title.text = f"Effects of the model on joint {joint + 1}"
        removable = self._workbench.session.inputs.mode == "missing"
        self._library.set_visibility(removable)
        self._list.clear()
        with self._list:
            for row in sorted(evaluation.effects, key=lambda row: row.joint != joint):
                if row.joint in (joint, None):
                    _effect_card(row, curves.get(row.label), self._unit(row), removable=removable)
            others = [row for row in evaluation.effects if row.joint not in (joint, None)]
            _other_joints(others, removable=removable)

    def _unit(self, row: EffectRow) -> str:
        """Return the unit of the torque of an effect."""
        opened = self._workbench.opened
        return "" if opened is None or row.joint is None else opened.units[row.joint]


def _effect_card(row: EffectRow, curve: EffectCurve | None, unit: str, *, removable: bool) -> None:
    """Show an effect with its values, and its torque once it is computed."""
    with named(ui.column(), f"effect-{place(row.label)}").classes("card"):
        with ui.row().classes("w-full items-center no-wrap gap-1"):
            ui.label(row.label).classes("strong grow")
            if removable:
                _remove_button(row.label).props("size=sm").props["title"] = "remove and fit again"
        ui.label(row.formula).classes("formula")
        for value in row.values:
            ui.label(value).classes("value")
        if curve is not None:
            ui.html(curve_svg(curve, unit), sanitize=False).classes("w-full")


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
                    _remove_button(row.label).props("size=xs")


def _remove_button(label: str) -> ui.button:
    button = acting(ui.button(icon="close").props("flat dense round"), label)
    button.props["aria-label"] = f"remove {label}"
    return named(button, f"remove-{place(label)}")


class ProposalsView:
    """Effects that the diagnosis proposes; a click adds one."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full grow-panel"):
            ui.label("Proposed effects").classes("panel-title")
            self._list = ui.column().classes("w-full gap-1 scroll")
        on_action(self._list, self._add)

    async def _add(self, label: str) -> None:
        """Add a proposed effect or a rival; with a kept fit, show the changed model."""
        session = self._workbench.session
        if session.inputs.mode == "changed":
            proposed = () if session.found is None else session.found.proposed
            for change in (p for p in proposed if p.label == label):
                await self._workbench.apply(session.with_change(change))
        else:
            await self._workbench.apply(session.with_effect(label))

    def update(self) -> None:
        """Show what was found, or what the running search has found so far."""
        workbench = self._workbench
        found, step, arriving = (
            workbench.session.found,
            workbench.session.step,
            workbench.search.arriving,
        )
        effects = () if step is None else step.effects_and_changes
        searching = workbench.search.activity is not None
        now = (id(found), effects, searching, len(arriving) if searching else 0)
        if now == self._shown:
            return
        self._shown = now
        self._list.clear()
        with self._list:
            if searching:
                for proposal in arriving:
                    ui.label(
                        f"found: {proposal.label}, held-out error of joint {proposal.joint + 1} "
                        f"{figures(proposal.before)} → {figures(proposal.after)} N·m"
                    ).classes("value")
                if not arriving:
                    ui.label("No effect found so far.").classes("muted")
                return
            if found is None:
                ui.label("“Find what is missing” searches the library of effects.").classes("muted")
                return
            for proposed in found.proposed:
                _proposal_card(
                    proposed,
                    present=proposed.label in effects,
                    changed=workbench.session.inputs.mode == "changed",
                )
            if not found.proposed:
                ui.label("The search found no effect.").classes("muted")
            for sentence in found.unexplained:
                ui.label(f"Unexplained: {sentence}.").classes("value")


def _proposal_card(proposed: ProposedEffect, *, present: bool, changed: bool) -> None:
    """Show a proposal, its evidence, and its rivals."""
    card = named(ui.column(), f"candidate-{place(proposed.label)}").classes("card candidate")
    if not present:
        acting(card, proposed.label).props["role"] = "button"
        card.props["tabindex"] = "0"
    with card:
        with ui.row().classes("w-full items-center no-wrap gap-1"):
            ui.label(proposed.label).classes("strong grow")
            if not present:
                ui.icon("add_circle").classes("add")
            else:
                ui.label("shown" if changed else "in the model").classes("muted small")
        error = "error" if changed else "held-out error"
        before, after = figures(proposed.before), figures(proposed.after)
        ui.label(f"{error} {before} → {after} N·m").classes("value")
        if proposed.value and changed:
            ui.label(f"change: {proposed.value}").classes("value")
        if proposed.selected is not None:
            part = f"selected in {100.0 * proposed.selected:.0f} % of resampled data"
            ui.label(part).classes("muted small")
        if proposed.confirmed is not None:
            falls = "falls" if proposed.confirmed else "does not fall"
            ui.label(f"the error on the test {falls}").classes("muted small")
        if proposed.rivals and not changed:
            _rivals(proposed)


def _rivals(proposed: ProposedEffect) -> None:
    """Show the rivals of a proposal; a click on one adds it in place of the proposal."""
    with ui.row().classes("gap-1 items-center"):
        ui.label("rivals").classes("muted small")
        for label, kind in proposed.rivals:
            chip = ui.chip(label).props("dense outline square clickable")
            exact = kind == "exact"
            chip.props["title"] = (
                "equivalent with any data" if exact else "not separable by this data"
            )
            named(acting(chip, label), f"candidate-{place(label)}")
