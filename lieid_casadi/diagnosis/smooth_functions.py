"""Smooth functions of one or two signals: which are worth trying, and formulas close to them.

There are hundreds of pairs of signals, and the effect `smooth` has many columns for each. A few
polynomials of every signal and their products show which of them the residual follows; of these
the effect itself becomes a candidate. A function that a diagnosis has added is compared with
products of elementary functions of its signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.special import chdtri
from scipy.stats import iqr

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.comparison.noise_floor import slow_functions
from lieid_casadi.diagnosis.candidates import Candidate
from lieid_casadi.diagnosis.columns import SegmentSignals
from lieid_casadi.diagnosis.findings import number
from lieid_casadi.diagnosis.path import LEAST_OWN_PART, Span
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.smooth import SIGNALS, TORQUE, Smooth
from lieid_casadi.identification.regression.variable_projection import shapes_of_data
from lieid_casadi.model import Model

#: Candidates of each joint: functions of its own signals, and of those of other joints; of one
#: signal, and as many of two.
PER_JOINT = 2
DEGREE, FINE_DEGREE = 6, 10  # of the polynomials of a signal; of angle and load
RIDGE = 1e-6  # of a column's square
MOST_ROUNDING = 0.5  # error of a signal by rounded positions, in half of its middle half
FIELDS = {name: field for name, (field, _, _) in SIGNALS.items()}
CONTAINED = "a smooth function of its signals was found before it"
OTHERS = ("q", "dq", "load")  # signals of other joints that are tried; alone, their torque, too
DEPENDENT = 1e-9  # of the largest singular value
LEAST_FOLLOWED = 0.5  # of a residual's square that signals must explain to be stated
FRICTION_WAVES = 2  # half periods of dry friction that changes with time, in a segment
MOST_TERMS = 3  # of a formula
CLOSE, LEAST_TERM = 0.97, 0.02  # part of a variance that is enough, and that a term must add
LEAST_EXPLAINED = 0.8  # of the variance, by a formula that is stated


def smooth_candidates(
    rows: Rows, span: Span, residuals: Sequence[Sequence[Array]], spread: Array, *, whole: bool
) -> list[Candidate]:
    """Return the smooth functions that one of several residuals follows most on each joint.

    Each residual has the values (R_j,) of every joint; ``spread`` (n,) is the standard deviation of
    the noise, N·m, by which the rows of ``span`` are weighted. If the model is kept, a function is
    ``whole``: no parameter of the model describes a part of it.
    """
    found: dict[str, Candidate] = {}
    weights = rows.weights(spread)
    every = np.column_stack([np.concatenate(residual) for residual in residuals])
    outside = span.outside(every * np.concatenate(weights)[:, None])
    rounding = _mostly_rounding(rows)
    for joint in sorted({c.joint for c in rows.columns.owners}):
        own_rows, weight = span.joint(joint), weights[joint][:, None]
        known = _polynomials(rows, joint).items()
        polynomials = {a: x for a, x in known if named_column(a, joint) not in rounding}
        for count in (1, 2):
            signals = _choices(polynomials, count)
            scores = np.zeros((len(signals), len(residuals)))
            for k, names in enumerate(signals):
                columns = _products(names, polynomials) * weight
                cost = cost_of(columns.shape[1], max(len(weight), 2), whole=whole)
                scores[k] = _gains(columns, outside[own_rows], span.basis[own_rows]) - cost
            of_joint = np.array([not any(map(_of_other, names)) for names in signals], dtype=bool)
            for of_residual in scores.T:
                for own in (of_joint, ~of_joint):
                    ranked = np.where(own, of_residual, 0.0)
                    best = [k for k in np.argsort(-ranked)[:PER_JOINT] if ranked[k] > 0.0]
                    wanted = [_candidate(rows, signals[k], joint, whole=whole) for k in best]
                    found |= {candidate.label: candidate for candidate in wanted}
    return list(found.values())


def _mostly_rounding(rows: Rows) -> set[str]:
    """Return the signals, as columns are named, that rounding of positions decides in most rows.

    Inertia multiplies its accelerations. At constant velocity, where these are little else, a
    function of them cancels that torque, and keeps the torque of high accelerations.
    """
    parts = [replace(s, ddq=s.ddq + s.rounding_of_ddq) for s in rows.segments]
    coarse, found = [SegmentSignals.of(rows.fit, s) for s in parts], set[str]()
    for name in ("ddq", "load"):
        values, rounded = (
            np.concatenate([s.segment.filter(s.values[name]) for s in signals])
            for signals in (rows.signals, coarse)
        )
        most = 2.0 * np.std(rounded - values, axis=0) > MOST_ROUNDING * iqr(values, axis=0)
        found |= {named_column(name, int(j)) for j in np.flatnonzero(most)}
    return found


def cost_of(parameters: float | Array, independent: float | Array, *, whole: bool | Mask) -> Array:
    """Return what groups of parameters must gain in a path, in a weighted sum of squares.

    That is log N of each (Schwarz, Annals of Statistics 1978). Of a ``whole`` function, beside a
    model that is kept, it is what noise, which is known there, exceeds with a probability of 1/N:
    the same for two parameters, and about half of it for ten.
    """
    tail = chdtri(parameters, 1.0 / np.asarray(independent))
    return np.asarray(np.where(whole, tail, parameters * np.log(independent)))


def functions_alike(rows: Rows, candidate: Candidate) -> int:
    """Return of how many functions of one or two signals a candidate is one.

    Functions of the joint's own signals are counted apart from those of other joints' signals.
    """
    names, joint = candidate.effect.option.split("."), candidate.joint
    every = _signals(rows, joint, torque=len(names) == 1)
    own, whole = (comb(n, len(names)) for n in (sum(j == joint for _, j in every), len(every)))
    return whole - own if any(map(_of_other, names)) else own


def followed_signals(rows: Rows, span: Span, joint: int, spread: Array) -> tuple[str, ...]:
    """Return the one or two signals that a joint's residual follows most; ``t`` is time.

    The residual is that of ``span``, whose rows are weighted by ``spread`` (n,), N·m.
    """
    basis, target = (x[span.joint(joint)] for x in (span.basis, span.residual))
    if not len(target):  # a joint that does not move in these recordings
        return ()
    total, weight = max(float(target @ target), 1e-300), rows.weights(spread)[joint][:, None]
    polynomials = _polynomials(rows, joint)
    known: dict[tuple[str, ...], Array] = {(a,): x for a, x in polynomials.items()}
    own = rows.runs[joint].all
    slow = [waves[:, ::2] for waves in slow_functions(rows.times[own], rows.segment_of[own])]
    known["t",] = np.hstack(slow)
    if "dq" in polynomials:  # dry friction that changes with time
        few = np.hstack([waves[:, :FRICTION_WAVES] for waves in slow])
        known["t", "dq"] = few * polynomials["dq"][:, :1]
    known |= {pair: _products(pair, polynomials) for pair in _choices(polynomials, 2)}
    # slow errors have fewer independent rows than samples: about one in a second
    seconds = max(len(np.unique(rows.times[rows.runs[joint].all] // 1.0)), 2)
    best: tuple[str, ...] = ()
    most = 0.0
    for names, columns in known.items():
        part = float(_gains(columns * weight, target[:, None], basis)[0]) / total
        score = -seconds * np.log(max(1.0 - part, 1e-6)) - columns.shape[1] * np.log(seconds)
        if score > most and part > LEAST_FOLLOWED:
            best, most = names, score
    return tuple(named_column(name, joint) for name in best)


def own_signals(effect: Effect) -> tuple[str, ...]:
    """Return the signals of its joint that an effect depends on, as smooth functions name them."""
    letters = {field: letter for letter, field in FIELDS.items()} | {"sign": "dq"}
    return tuple(dict.fromkeys(letters[s] for s in effect.signals if s in letters))


def contains(function: Candidate, other: Candidate) -> bool:
    """Return whether an effect is a piece of the form of a function of its joint's one signal."""
    signals = own_signals(other.effect) if "time" not in other.effect.signals else ()
    of_same = function.name == Smooth.name != other.name and function.joints == other.joints
    return of_same and signals == (function.effect.option,)


def named_column(signal: str, joint: int) -> str:
    """Return a signal as columns are named, ``dq3``: one without a number is the joint's own."""
    return signal if signal == "t" or _of_other(signal) else f"{signal}{joint + 1}"


def _of_other(signal: str) -> bool:
    """Return whether a signal is that of another joint."""
    return signal[-1].isdigit()


def _products(names: Sequence[str], polynomials: Mapping[str, Array]) -> Array:
    """Return the polynomials of one signal, or the first ones of two and their products."""
    if len(names) == 1:
        return polynomials[names[0]]
    # as in the effect itself, a velocity is friction that the other signal modulates
    letters = [name.rstrip("0123456789") for name in names]
    most = {"dq": 2, "q": 6 if "dq" in letters else 3}
    few = [polynomials[name][:, : most.get(a, 3)] for name, a in zip(names, letters, strict=True)]
    products = np.einsum("ra,rb->rab", *few).reshape(len(few[0]), -1)
    modulated = [x for x, a in zip(few, letters, strict=True) if a == "dq" or "dq" not in letters]
    return products if letters == ["dq", "dq"] else np.hstack([*modulated, products])


def _signals(rows: Rows, joint: int, *, torque: bool) -> list[tuple[str, int]]:
    """Return the signals of which a torque may be a function; the ``torque`` of others is alone."""
    warmth = all(s.segment.temperature is not None for s in rows.signals)
    own = [(name, joint) for name in FIELDS if name != "temp" or warmth]
    others = [j for j in range(len(rows.runs)) if j != joint]
    return own + [(name, j) for j in others for name in (*OTHERS, *[TORQUE] * torque)]


def _choices(polynomials: Mapping[str, Array], count: int) -> list[tuple[str, ...]]:
    """Return the sets of so many signals of which functions are tried."""
    return list(combinations([a for a in polynomials if count == 1 or TORQUE not in a], count))


def _polynomials(rows: Rows, joint: int) -> dict[str, Array]:
    """Return, by the name of each signal as in ``smooth/dq.q5``, polynomials of it (R_j, k)."""
    found: dict[str, Array] = {}
    for name, j in _signals(rows, joint, torque=True):
        label = name if j == joint else f"{name}{j + 1}"
        if name == TORQUE:
            parts = [found[f"{a}{j + 1}"][:, :k] for a, k in (("load", 1), ("dq", 2))
                     if f"{a}{j + 1}" in found]  # fmt: skip
            found |= {label: np.hstack(parts)} if len(parts) == 2 else {}
            continue
        values = _along(rows, joint, FIELDS[name], j)
        low, high = np.percentile(values, [0.5, 99.5]) if len(values) else (0.0, 0.0)
        if high - low < 1e-9:
            continue
        if name == "dq":
            x = np.clip(values / max(abs(low), abs(high)), -1.2, 1.2)
            odd = [x * np.abs(x), x**3] if j == joint else []  # the model has the others
            found[label] = np.column_stack([np.sign(x), x, np.abs(x), *odd])
        else:
            x = np.clip(2.0 * (values - low) / (high - low) - 1.0, -1.0, 1.0)
            found[label] = chebvander(x, FINE_DEGREE if name in ("q", "load") else DEGREE)[:, 1:]
    return found


def _along(rows: Rows, joint: int, field: str, j: int) -> Array:
    """Return a signal of joint j on the rows of a joint (R_j,)."""
    values = [s.values[field][s.segment.kept, j] for s in rows.signals]
    return np.asarray(np.concatenate(values)[rows.runs[joint].all])


def _gains(columns: Array, targets: Array, basis: Array) -> Array:
    """Return the fall of the sum of squares of targets by a joint's columns outside the model.

    ``basis`` (R_j, p) are the joint's rows of an orthonormal basis of the model on all joints,
    since the parameters of a link act on several.
    """
    along, products = basis.T @ columns, columns.T @ targets
    gram = columns.T @ columns
    ridge = RIDGE * np.maximum(np.diag(gram), 1e-300)
    gram += np.diag(ridge) - along.T @ along
    return np.asarray(np.einsum("kt,kt->t", products, np.linalg.solve(gram, products)))


def _candidate(rows: Rows, signals: Sequence[str], joint: int, *, whole: bool) -> Candidate:
    """Return the effect on some signals, with the ranges of the recordings."""
    placement = Placement(Smooth(option=".".join(signals), whole=whole), joint)
    alone = Model.of_placements(rows.fit.model.robot, (placement,))
    return Candidate(placement, shapes_of_data(alone, rows.segments)[None])


def formula_of(rows: Rows, placement: Placement, own: Indices, values: Array) -> str:
    """Return a formula that is close to a fitted smooth function; empty if none is.

    Both are compared outside the span of the other columns of the model, which may contain any
    part of either. ``own`` are the function's columns of ``rows.model``, ``values`` (k,) theirs.
    """
    joint = placement.joint
    span = Span.of([np.delete(m, own, axis=1) for m in rows.model], rows.residual)
    texts, columns = _elementary(rows, placement)
    both = np.zeros((len(span.joint_of), len(texts) + 1))
    both[span.joint(joint)] = np.column_stack([columns, rows.model[joint][:, own] @ values])
    outside = span.outside(both)
    rest, target = outside[:, :-1], outside[:, -1]
    rest[:, _size(rest) < LEAST_OWN_PART * _size(both[:, :-1])] = 0.0  # the model has nearly all
    chosen: list[int] = []
    found, explained = np.zeros(0), 0.0
    while len(chosen) < MOST_TERMS and explained < CLOSE:
        parts = []
        for k in range(len(texts)):
            used = rest[:, [*chosen, k]]
            fitted = np.linalg.lstsq(used / _size(used), target, rcond=DEPENDENT)[0]
            error = target - used / _size(used) @ fitted
            parts.append((1.0 - float(error @ error) / float(target @ target), k, fitted))
        best, k, fitted = max(parts, key=lambda part: part[:2])
        if best < explained + LEAST_TERM:
            break
        chosen.append(k)
        explained, found = best, fitted / _size(rest[:, chosen])
    if explained < LEAST_EXPLAINED:
        return ""
    terms = [f"{number(c)}·{texts[k]}" for c, k in zip(found, chosen, strict=True)]
    return f"{' + '.join(terms).replace('+ −', '− ')} ({100 * explained:.0f} % of its variance)"


def _elementary(rows: Rows, placement: Placement) -> tuple[list[str], Array]:
    """Return elementary functions of the signals of a smooth function, and their products."""
    each = []
    assert isinstance(placement.effect, Smooth)
    for name, other in placement.effect.parts:
        j = placement.joint if other is None else other
        x, label = _along(rows, placement.joint, FIELDS[name], j), f"{name}{j + 1}"
        known = {label: x, f"{label}²": x**2, f"{label}³": x**3, f"|{label}|": np.abs(x)}
        if name == "q":
            known |= {f"sin({label})": np.sin(x), f"cos({label})": np.cos(x)}
            known |= {f"sin(2·{label})": np.sin(2.0 * x), f"cos(2·{label})": np.cos(2.0 * x)}
        else:
            known[f"sgn({label})"] = np.sign(x)
        each.append(known)
    every = {text: f for known in each for text, f in known.items()}
    if len(each) == 2:
        every |= {f"{a}·{b}": f * g for a, f in each[0].items() for b, g in each[1].items()}
    return list(every), np.column_stack(list(every.values()))


def _size(columns: Array) -> Array:
    """Return the norms of columns; by those of zeros, zeros can be divided."""
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
