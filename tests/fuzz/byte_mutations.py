"""Mutations of bytes, whatever they mean."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

#: Integers at which parsers of lengths and counts go wrong.
INTEGERS = (0, 1, 2, 7, 8, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1,
            2**40, 2**53, 2**63 - 1, 2**63, 2**64 - 1)  # fmt: skip


def mutate_bytes(data: bytes, rng: random.Random, other: bytes = b"") -> bytes:
    """Return ``data`` after one to four random changes of its bytes.

    Parameters
    ----------
    data
        A valid file, or an already mutated one.
    rng
        Decides everything, so that a seed reproduces the mutation.
    other
        Another file of the same format, of which a part may be inserted.
    """
    made = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        rng.choice(_MUTATIONS)(made, rng)
    if other and rng.random() < 0.1:
        start, end = _range(other, rng)
        place = rng.randrange(len(made) + 1)
        made[place:place] = other[start:end]
    return bytes(made)


def _range(data: bytes | bytearray, rng: random.Random, longest: int = 256) -> tuple[int, int]:
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.randint(1, longest))


def _flip(data: bytearray, rng: random.Random) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _set(data: bytearray, rng: random.Random) -> None:
    if data:
        data[rng.randrange(len(data))] = rng.randrange(256)


def _delete(data: bytearray, rng: random.Random) -> None:
    start, end = _range(data, rng)
    del data[start:end]


def _insert(data: bytearray, rng: random.Random) -> None:
    start, _ = _range(data, rng)
    data[start:start] = rng.randbytes(rng.randint(1, 32))


def _repeat(data: bytearray, rng: random.Random) -> None:
    start, end = _range(data, rng)
    data[start:start] = data[start:end] * rng.choice((1, 2, 16))


def _truncate(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(len(data) + 1) :]


def _zero(data: bytearray, rng: random.Random) -> None:
    start, end = _range(data, rng, 64)
    data[start:end] = bytes(end - start)


def _integer(data: bytearray, rng: random.Random) -> None:
    form, size = rng.choice((("<H", 2), ("<I", 4), ("<Q", 8), (">I", 4)))
    if len(data) >= size:
        start = rng.randrange(len(data) - size + 1)
        struct.pack_into(form, data, start, rng.choice(INTEGERS) % 2 ** (8 * size))


_MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip, _flip, _set, _delete, _insert, _repeat, _truncate, _zero, _integer, _integer,
)  # fmt: skip
