"""Mutations of bytes, and of CSV, XML, YAML and JSON as texts."""

from __future__ import annotations

import json
import random
import re
import struct
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import yaml

#: Numbers, in writing, at which readers go wrong.
NUMBERS = ("0", "-1", "-0.0", "1e300", "-1e300", "1e-300", "5e-324", "1e999", "-1e999", "nan",
           "inf", "-inf", "1e9", "1000000000", "0x_", "0x1F", "1_000", "1e", "-", "+", ".", "",
           "9" * 400, "9" * 5000, "1.5.2", "٣", "１２", "true", "null", "~", "2001-99-99",
           "12:30:45", "1e200")  # fmt: skip
#: Fragments that have a meaning in one of the text formats.
FRAGMENTS = ("&a ", "*a", "!!int q", "!!python/object:os.system x", "!!binary ==", "!!set {a}",
             "!!timestamp 2001-13-45", "<<: *a", "[" * 2000, "{a: " * 500, "---\n", "...\n",
             "%YAML 9.9\n", "\t", "\r", "\0", "\x85", "\u2028", "\ufeff", "\ud7ff", "\u202e", ";",
             ",", '"', "'", ":", "#", "<!--", "-->", "<![CDATA[", "]]>", "&lt;", "&undefined;",
             '<!DOCTYPE a [<!ENTITY b "bb">]>', "<a>", "</a>", "/>", "t", "q1", "dq1", "tau99999",
             "load", "q9999999999")  # fmt: skip

_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def replace_number(data: bytes, rng: random.Random) -> bytes:
    """Replace one number of a text by another one or by something that only resembles one."""
    found = list(_NUMBER.finditer(data))
    if not found:
        return insert_fragment(data, rng)
    place = rng.choice(found)
    return data[: place.start()] + rng.choice(NUMBERS).encode() + data[place.end() :]


def insert_fragment(data: bytes, rng: random.Random) -> bytes:
    """Insert a fragment that has a meaning in one of the text formats."""
    place = rng.randrange(len(data) + 1)
    fragment = rng.choice(FRAGMENTS).encode() * rng.choice((1, 1, 1, 50))
    return data[:place] + fragment + data[place:]


def change_lines(data: bytes, rng: random.Random) -> bytes:
    """Delete, repeat or exchange lines."""
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data * rng.choice((0, 2, 100))
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    change = rng.randrange(3)
    if change == 0:
        del lines[min(a, b) : max(a, b)]
    elif change == 1:
        lines[a:a] = [lines[b]] * rng.choice((1, 2, 500))
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def mutate_text(data: bytes, rng: random.Random) -> bytes:
    """Return a text after a random change of a number, of lines, or a fragment."""
    return rng.choice((replace_number, replace_number, insert_fragment, change_lines))(data, rng)


def mutate_csv(data: bytes, rng: random.Random) -> bytes:
    """Return a CSV after a change of its cells, of a whole column, or of its text."""
    if rng.random() < 0.5:
        return mutate_text(data, rng)
    rows = [line.split(b",") for line in data.splitlines()]
    if len(rows) < 2 or not rows[0]:
        return mutate_text(data, rng)
    column = rng.randrange(len(rows[0]))
    change = rng.randrange(5)
    if change == 0:  # other units or scales
        _scale(rows, column, 10.0 ** rng.choice((-300, -9, -6, -3, 3, 6, 9, 300)))
    elif change == 1:  # a gap, or a jump
        first = rng.randrange(1, len(rows))
        _shift(rows[first:], column, rng.choice((1e-9, 1.0, 1e6, 1e12, -5.0)))
    elif change == 2:
        rows = [[*row[:column], *row[column + 1 :]] for row in rows]
    elif change == 3:
        name = rng.choice((b"t", b"q1", b"dq1", b"tau1", b"load", b"temp1", b"i2", b"x", b""))
        rows[0][column] = name
    else:
        constant = rng.choice(NUMBERS).encode()
        rows[1:] = [[*row[:column], constant, *row[column + 1 :]] for row in rows[1:]]
    return b"\n".join(b",".join(row) for row in rows)


def _scale(rows: list[list[bytes]], column: int, factor: float) -> None:
    for row in rows[1:]:
        if column < len(row) and _NUMBER.fullmatch(row[column]):
            row[column] = repr(float(row[column]) * factor).encode()


def _shift(rows: list[list[bytes]], column: int, step: float) -> None:
    for row in rows:
        if column < len(row) and _NUMBER.fullmatch(row[column]):
            row[column] = repr(float(row[column]) + step).encode()


# -- trees ----------------------------------------------------------------------------


def change_tree(tree: Any, rng: random.Random) -> Any:
    """Return plain data (dicts, lists, scalars) with one node changed, removed or repeated."""
    places = list(_places(tree))
    if not places:
        return _value(rng)
    parent, key = rng.choice(places)
    change = rng.randrange(6)
    if change == 0:
        del parent[key]
    elif change == 1:
        parent[key] = _value(rng)
    elif change == 2:
        parent[key] = rng.choice(places)[0]
        return json.loads(json.dumps(parent, default=str)) if parent is tree else _detached(tree)
    elif change == 3 and isinstance(parent, list):
        parent[key:key] = [parent[key]] * rng.choice((1, 2, 50))
    elif change == 4 and isinstance(parent, dict):
        parent[rng.choice(("name", "x", "", "kind", "joints", "schema"))] = parent.pop(key)
    else:
        parent[key] = [parent[key]]
    return tree


def _places(tree: Any) -> Any:
    if isinstance(tree, dict | list):
        for key in tree if isinstance(tree, dict) else range(len(tree)):
            yield tree, key
            yield from _places(tree[key])


def _detached(tree: Any) -> Any:
    """Return a copy without cycles; a tree that contains itself becomes its innermost part."""
    try:
        return json.loads(json.dumps(tree, default=str))
    except (ValueError, RecursionError):
        return {"joints": []}


def _value(rng: random.Random) -> Any:
    nested: Any = 0
    for _ in range(rng.choice((3, 200))):
        nested = [nested]
    choices = [0, 1, -1, 1e300, -1e300, 1e-300, 10**9, 10**400, True, None, "", "nan", "a" * 1000,
               [], {}, [0] * 1000, nested, float("nan"), float("inf"), "\u202e", "1e999",
               2**63]  # fmt: skip
    return rng.choice(choices)


def mutate_json(data: bytes, rng: random.Random) -> bytes:
    """Return JSON after a change of its tree (most often) or of its text."""
    if rng.random() < 0.3 or len(data) > 10**6:
        return mutate_text(data, rng)
    try:
        tree = change_tree(json.loads(data), rng)
        return json.dumps(tree, ensure_ascii=False).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        return mutate_text(data, rng)


def mutate_yaml(data: bytes, rng: random.Random) -> bytes:
    """Return YAML after a change of its tree or of its text, or with aliases in it."""
    kind = rng.random()
    # aliases are left to the reader: the mutation must not expand a bomb itself
    if kind < 0.5 or b"*" in data or len(data) > 10**6:
        return mutate_text(data, rng)
    if kind < 0.55:
        return data + alias_bomb(rng.choice((3, 12, 40)))
    try:
        return yaml.safe_dump(change_tree(yaml.safe_load(data), rng)).encode()
    except (ValueError, RecursionError, yaml.YAMLError, AttributeError):
        return mutate_text(data, rng)


def alias_bomb(levels: int) -> bytes:
    """Return a YAML mapping whose expanded size is 9 to the power of its levels."""
    lines = ["bomb:", "  - &a0 [x, x]"]
    lines += [f"  - &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, levels)]
    return ("\n" + "\n".join(lines) + "\n").encode()


def mutate_xml(data: bytes, rng: random.Random) -> bytes:
    """Return XML after a change of an attribute or an element (most often) or of its text."""
    if rng.random() < 0.4:
        return mutate_text(data, rng)
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError):
        return mutate_text(data, rng)
    elements = list(root.iter())
    element, other = rng.choice(elements), rng.choice(elements)
    change = rng.randrange(5)
    if change <= 1 and element.attrib:
        key = rng.choice(list(element.attrib))
        values = [*NUMBERS[:-8], *other.attrib.values(), "0 0 0", "1e200 0 0", "nan nan nan"]
        element.attrib[key] = rng.choice(values)
    elif change == 2 and element.attrib:
        del element.attrib[rng.choice(list(element.attrib))]
    elif change == 3 and len(element):
        element.remove(rng.choice(list(element)))
    elif other is not root and element not in list(other.iter()):
        element.append(other)
    return ElementTree.tostring(root)


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
