"""Parts of sentences: lists of words, falls of an error that are too small."""

from __future__ import annotations

from collections.abc import Sequence


def join_words(words: Sequence[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    return " and ".join([*([", ".join(words[:-1])] if len(words) > 1 else []), words[-1]])


def small_fall(fall: float) -> str:
    """Return ``falls by only 1.2 %`` or, of a negative fall, ``rises by 1.2 %``.

    Parameters
    ----------
    fall : float
        Of an error, relative to it.
    """
    return f"falls by only {100 * fall:.1f} %" if fall >= 0.0 else f"rises by {-100 * fall:.1f} %"
