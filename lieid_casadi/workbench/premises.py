"""Whether robot and recordings belong together: findings, and buttons that correct them."""

from __future__ import annotations

import shlex

from markupsafe import Markup
from nicegui import ui

from lieid_casadi.premises import Finding, PremiseCheck
from lieid_casadi.premises.correction import OPTIONS as CORRECTIONS
from lieid_casadi.workbench.elements import Parts, View, icon_part, named, part, set_text, text
from lieid_casadi.workbench.workbench import Workbench


class PremisesView(View):
    """The findings above everything else; a line with the verdict stays."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("premise-panel") as self._panel:
            self._status = text("", "small muted ellipsis w-full", "premises")
            self._list = Parts("findings", self._act)
        named(self._panel, "premise-panel")

    async def _act(self, action: str) -> None:
        """Apply the correction of a finding, or take one back."""
        kind, _, words = action.partition(" ")
        workbench = self.workbench
        if kind == "apply":
            await workbench.correct(shlex.split(words))
        else:
            await workbench.open(workbench.session.inputs.without_option(words))

    def update(self) -> None:
        """Show what the check has found, and the corrections that are applied."""
        workbench, found = self.workbench, self.workbench.premises
        self._panel.set_visibility(workbench.opened is not None)
        set_text(self._status, _status(found))
        if isinstance(found, PremiseCheck):
            why = "; ".join(f"{name}: {reason}" for name, reason in found.not_checkable)
            self._status.props["title"] = f"not checked: {why}" if why else self._status.text
        findings = found.findings if isinstance(found, PremiseCheck) else ()
        applied = [o for o in workbench.session.inputs.options if f"--{o[0]}" in CORRECTIONS]
        self._list.show(*map(_row, findings), *([_applied(applied)] if applied else []))


def _status(found: PremiseCheck | str | None) -> str:
    if found is None:
        return "Premises: being tested"
    if isinstance(found, str):
        return f"Premises: not tested ({found})"
    return f"Premises: {found.sentence} {len(found.checked)} tested."


def _row(finding: Finding) -> Markup:
    """Return a finding; the button applies the option that corrects it, if it has one."""
    state = "wrong" if finding.certain else "doubtful"
    button = Markup()
    if finding.remedy.startswith("--"):
        button = part(
            "part-button strong-button", f"Correct with {finding.remedy}",
            id=f"correct-{finding.premise}", tip="open the recordings again with this option",
            action=f"apply {finding.remedy}",
        )  # fmt: skip
    shown = [part(f"status {state}", state), part("grow premise-text", finding.sentence)]
    return part("finding", *shown, button, id=f"premise-{finding.premise}")


def _applied(options: list[tuple[str, tuple[str, ...]]]) -> Markup:
    """Return the corrections that are applied; each can be taken back."""
    chips = [
        part(
            "chip", " ".join([f"--{name}", *values]),
            icon_part("close", f"remove {name}", "do not correct this", id=f"uncorrect-{name}"),
        )
        for name, values in options
    ]  # fmt: skip
    return part("chips", part("muted small", "corrected by"), *chips)
