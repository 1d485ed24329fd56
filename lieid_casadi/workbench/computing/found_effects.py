"""A diagnosis as the page shows it."""

from __future__ import annotations

from lieid_casadi.diagnosis import Diagnosis, DiagnosisStep
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.workbench.state.proposals import FoundEffects, ProposedEffect
from lieid_casadi.workbench.state.session import ModelStep


def found_effects(diagnosis: Diagnosis, step: ModelStep) -> FoundEffects:
    """Return what a diagnosis of a step's model proposes."""
    return FoundEffects(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        proposed=tuple(_proposed(each) for each in diagnosis.steps),
        effects=step.effects,
        unexplained=tuple(
            f"joint {part.joint + 1}: {part.relation}" for part in diagnosis.unexplained
        ),
        shapes=tuple(
            (parameter.label, float(value))
            for parameter, value in zip(
                diagnosis.fit.model.shapes, diagnosis.fit.shapes, strict=True
            )
        ),
    )


def _proposed(step: DiagnosisStep) -> ProposedEffect:
    content = step.to_dict()
    return ProposedEffect(
        label=step.label,
        effect=step.effect,
        joints=tuple(j + 1 for j in step.joints),
        joint=_joint(step),
        before=number_or_none(step.evidence.held_out_before),
        after=number_or_none(step.evidence.held_out_after),
        selected=content.get("selected"),
        confirmed=step.evidence.confirmed,
        rivals=tuple((c.placement.label, kind) for c, kind in step.indistinguishable),
        value=", ".join(
            f"{name} = {value:.4g}{'' if step.units[name] == '1' else ' ' + step.units[name]}"
            for name, value in step.parameters.items()
        ),
        parameters=tuple(step.parameters.items()),
    )


def _joint(step: DiagnosisStep) -> int:
    """Return the joint, from 0, that an effect is listed under."""
    return step.joints[0] if step.joints else 0
