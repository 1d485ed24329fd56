"""Friction models of the literature, as sets of effects."""

from __future__ import annotations

from dataclasses import dataclass

from lieid_casadi.errors import EffectError


@dataclass(frozen=True)
class FrictionModel:
    """A published friction model: effects on every joint, and where it was published.

    ``note`` has differences from the publication. If its formula was not available in full
    (``reconstructed``), it says what is known of it and how it is interpreted here.
    """

    name: str
    effects: tuple[str, ...]
    source: str
    note: str = ""
    reconstructed: bool = False


_PAPER = "Luo et al., Robotica 2024"
_POLYNOMIAL = ("viscous", "viscous_polynomial")

FRICTION_MODELS: dict[str, FrictionModel] = {
    model.name: model
    for model in (
        FrictionModel("coulomb_viscous", ("coulomb", "viscous", "offset"), f"{_PAPER}, Eq. 10"),
        FrictionModel(
            "stribeck",
            ("coulomb", "viscous", "stribeck"),
            f"Tustin, J. IEE 1947; {_PAPER}, Eq. 6 with δ_s = 2",
        ),
        FrictionModel(
            "tustin",
            ("coulomb", "viscous", "stribeck/exponent"),
            f"Tustin, J. IEE 1947; {_PAPER}, Eq. 6",
        ),
        FrictionModel(
            "eq7",
            (*_POLYNOMIAL, "stribeck/two_width"),
            f"{_PAPER}, Eq. 7, after Dong et al., IEEE TIM 2021",
        ),
        FrictionModel(
            "paper",
            (*_POLYNOMIAL, "stribeck/two_width", "load_friction/paper"),
            f"{_PAPER}, Eqs. 8 and 18, ten coefficients",
            "|q̇| in the exponent is √(q̇² + ε²), finite at rest",
        ),
        FrictionModel("simplified", ("coulomb", *_POLYNOMIAL, "offset"), f"{_PAPER}, Eq. 17"),
        FrictionModel(
            "gao2017",
            ("coulomb", "stribeck", "load_friction", "temperature_friction/exponential"),
            "Gao et al., IROS 2017 (the paper's ref. 7): velocity, temperature and load",
            "published as one formula of velocity, temperature and load; its terms were not "
            "available. Interpreted here as a Stribeck curve, viscous friction that falls "
            "exponentially with temperature, and dry friction in proportion to |load|. Needs a "
            "measured temperature",
            reconstructed=True,
        ),
        FrictionModel(
            "gao2017_constant_temperature",
            ("coulomb", "stribeck", "load_friction", "viscous"),
            "Gao et al., IROS 2017 (the paper's ref. 7), at one temperature",
            "published as one formula of velocity, temperature and load; its terms were not "
            "available. Interpreted here as a Stribeck curve, viscous friction and dry friction in "
            "proportion to |load|, at constant temperature",
            reconstructed=True,
        ),
        FrictionModel(
            "he2021",
            ("coulomb", "viscous", "stribeck", "load_friction/stribeck"),
            "He et al., ROBIO 2021 (the paper's ref. 14): low speed",
            "published as a Stribeck curve at low speed whose depth depends on the load; its terms "
            "were not available. Interpreted here as the load-dependent part of Bittencourt et "
            "al., IROS 2010, with exponent 2",
            reconstructed=True,
        ),
        FrictionModel(
            "madsen2020",
            ("viscous", "viscous_polynomial", "presliding/square"),
            "Madsen et al., Control Engineering Practice 2020 (the paper's ref. 25), in the form "
            "of the authors' program AURT: (F_c + F_cl·τ²)·h + powers of velocity, h a hysteresis",
            "from the source of the program, where h is the sign (its generalized Maxwell-slip h "
            "falls back to that) and the powers are a setting. Interpreted here as one Dahl "
            "element for h, powers 1 to 3, and no joint flexibility",
        ),
        FrictionModel(
            "panda_sigmoid",
            ("sigmoid_friction",),
            "Gaz et al., IEEE RA-L 2019 (the paper's ref. 11)",
        ),
        FrictionModel(
            "load_constant", ("coulomb", "viscous"), "AURT (Madsen et al.), load model 'none'"
        ),
        FrictionModel(
            "load_absolute",
            ("coulomb", "viscous", "load_friction"),
            "AURT (Madsen et al.), load model 'abs'",
        ),
        FrictionModel(
            "load_square",
            ("coulomb", "viscous", "load_friction/square"),
            "AURT (Madsen et al.), load model 'square'",
        ),
        FrictionModel(
            "hamon2010",
            ("coulomb", "viscous", "load_friction/motoring", "offset"),
            "Hamon, Gautier, Garrec, IROS 2010 (the paper's ref. 12)",
        ),
    )
}


def friction_model(name: str) -> FrictionModel:
    """Return a friction model by name.

    Raises
    ------
    EffectError
        No model has that name; the message lists those that exist.
    """
    if name not in FRICTION_MODELS:
        raise EffectError(
            f"unknown friction model {name!r}; expected one of {', '.join(FRICTION_MODELS)}"
        )
    return FRICTION_MODELS[name]
