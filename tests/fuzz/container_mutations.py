"""Mutations of binary containers: gzip, NPZ, Parquet, MCAP and SQLite."""

from __future__ import annotations

import gzip
import io
import random
import sqlite3
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator

import numpy as np
from fuzz.text_mutations import INTEGERS, mutate_bytes, mutate_csv

MCAP_MAGIC = b"\x89MCAP0\r\n"


def mutate_gzip(data: bytes, rng: random.Random) -> bytes:
    """Return a valid gzip file of a mutated CSV, of several members, or of very many zeros."""
    try:
        inside = gzip.decompress(data)
    except (OSError, EOFError, zlib.error):
        return mutate_bytes(data, rng)
    kind = rng.randrange(8)
    if kind == 0:
        return data + gzip.compress(inside, 1, mtime=0) + rng.randbytes(rng.choice((0, 5)))
    if kind == 1:
        return gzip.compress(inside + bytes(10**6), 6, mtime=0)
    return gzip.compress(mutate_csv(inside, rng), 1, mtime=0)


# -- NPZ ------------------------------------------------------------------------------


def mutate_npz(data: bytes, rng: random.Random) -> bytes:
    """Return an archive with a member's array, header, name or zip record changed."""
    members = zip_members(data)
    if not members:
        return mutate_bytes(data, rng)
    name = rng.choice(list(members))
    kind = rng.randrange(7)
    if kind == 0:
        members[name] = _other_header(members[name], rng)
    elif kind == 1:
        members[name] = mutate_bytes(members[name], rng)
    elif kind == 2:
        members[rng.choice(("q.npy", "dq.npy", "load.npy", "x.npy", "t"))] = members.pop(name)
    elif kind == 3:
        del members[name]
    elif kind == 4:
        members["unknown.npy"] = _saved(np.zeros(10**5)) if rng.random() < 0.5 else b"junk"
    else:
        members[name] = _saved(_other_array(members[name], rng))
    made = zipped(members, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    if rng.random() < 0.3:
        made = _other_record(made, rng)
    return made


def zip_members(data: bytes) -> dict[str, bytes]:
    """Return the members of an archive; none of a damaged one."""
    damage = (zipfile.BadZipFile, ValueError, OSError, EOFError, RuntimeError, zlib.error)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(info.file_size for info in archive.infolist()) > 10**8:
                return {}
            return {name: archive.read(name) for name in archive.namelist()}
    except damage:
        return {}


def zipped(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return an archive whose bytes do not depend on the time."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return out.getvalue()


def _saved(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def _other_header(content: bytes, rng: random.Random) -> bytes:
    """Return an array's file with another shape or type in its header; the data stays."""
    shape = rng.choice(("(10**3,)", "(4000000000, 2)", "(2, -1)", "()", "(0, 2)", "(24, 2, 1)",
                        "(9223372036854775807,)", "(1.5,)", "None"))  # fmt: skip
    kind = rng.choice(("'<f8'", "'|O'", "'<c16'", "'<M8[ns]'", "'<U9'", "'<f2'", "'|V8'", "'<x9'",
                       "[('a', '<f8')]", "'<f16'", "'|S3'"))  # fmt: skip
    text = f"{{'descr': {kind}, 'fortran_order': {rng.choice(('True', 'False', '3'))}, "
    text += f"'shape': {shape}, }}\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + content[128:]


def _other_array(content: bytes, rng: random.Random) -> np.ndarray:
    try:
        array = np.load(io.BytesIO(content))
    except (ValueError, OSError, EOFError, SyntaxError, tokenize.TokenError):
        array = np.zeros(3)
    with np.errstate(all="ignore"):
        changes: tuple[Callable[[], np.ndarray], ...] = (
            lambda: array * 10.0 ** rng.choice((-300, -9, -3, 3, 6, 9, 300)),
            lambda: array[::-1],
            lambda: array[:1],
            lambda: array.astype(rng.choice(("f4", "i1", "i8", "?", "c16", "O", "U8", "S2"))),
            lambda: np.stack([array, array]),
            lambda: np.full_like(array, rng.choice((0.0, np.nan, np.inf, 1e308, -1e308))),
            lambda: np.concatenate([array[: len(array) // 2], array[len(array) // 2 :] + 1e6]),
            lambda: np.tile(array, 4),
        )
        try:
            return rng.choice(changes)()
        except (TypeError, ValueError):
            return np.zeros((2, 2))


def _other_record(data: bytes, rng: random.Random) -> bytes:
    """Change flags, method or sizes in a record of the zip's directory or a member's header."""
    made = bytearray(data)
    kind, fields = rng.choice(((b"PK\x01\x02", (8, 10, 20, 24, 42)), (b"PK\x03\x04", (6, 8, 18))))
    places = [k for k in range(len(made)) if made.startswith(kind, k)]
    if places:
        value = rng.choice((1, 8, 9, 12, 14, 93, 99, 2**16 - 1))
        struct.pack_into("<H", made, rng.choice(places) + rng.choice(fields), value)
    return bytes(made)


# -- containers of records ------------------------------------------------------------


def mutate_mcap(data: bytes, rng: random.Random) -> bytes:
    """Return an MCAP file with one of its records changed, removed, repeated or moved."""
    return _changed_records(data, rng, len(MCAP_MAGIC), _mcap_records)


def _changed_records(
    data: bytes,
    rng: random.Random,
    start: int,
    split: Callable[[bytes, int], Iterator[tuple[int, int]]],
) -> bytes:
    ends = list(split(data, start))
    if not ends:
        return mutate_bytes(data, rng)
    records = [data[a:b] for a, b in ends]
    tail = data[ends[-1][1] :]
    k = rng.randrange(len(records))
    kind = rng.randrange(8)
    if kind == 0:
        del records[k]
    elif kind == 1:
        records[k:k] = [records[k]] * rng.choice((1, 20))
    elif kind == 2:
        other = rng.randrange(len(records))
        records[k], records[other] = records[other], records[k]
    elif kind <= 5:
        records[k] = _with_integer(records[k], rng)
    else:
        records[k] = mutate_bytes(records[k], rng)
    return data[:start] + b"".join(records) + tail


def _with_integer(record: bytes, rng: random.Random) -> bytes:
    """Overwrite an aligned or unaligned integer near the record's beginning."""
    made = bytearray(record)
    size, form = rng.choice(((2, "<H"), (4, "<I"), (8, "<Q")))
    if len(made) < size:
        return record
    place = rng.randrange(min(len(made) - size + 1, 64))
    struct.pack_into(form, made, place, rng.choice(INTEGERS) % 2 ** (8 * size))
    return bytes(made)


def _mcap_records(data: bytes, place: int) -> Iterator[tuple[int, int]]:
    while place + 9 <= len(data) - len(MCAP_MAGIC):
        end = place + 9 + int(struct.unpack_from("<Q", data, place + 1)[0])
        if end > len(data):
            return
        yield place, end
        place = end


def mutate_sqlite(data: bytes, rng: random.Random) -> bytes:
    """Return a SQLite database with a value, a column or a table changed by SQL."""
    statements = (
        "UPDATE messages SET data = x'00' WHERE id = 2",
        "UPDATE messages SET data = NULL WHERE id = 2",
        "UPDATE messages SET data = randomblob(80) WHERE id = 3",
        "UPDATE messages SET data = zeroblob(1000000) WHERE id = 3",
        "UPDATE messages SET timestamp = timestamp * 1000000",
        "UPDATE messages SET timestamp = 'x' WHERE id = 2",
        "UPDATE messages SET timestamp = -timestamp",
        "UPDATE messages SET topic_id = 99",
        "UPDATE topics SET type = 'sensor_msgs/msg/Nothing'",
        "UPDATE topics SET type = x'ff00'",
        "UPDATE topics SET name = 5",
        "UPDATE topics SET serialization_format = 'json'",
        "UPDATE topics SET offered_qos_profiles = 'a: [&b *b'",
        "DELETE FROM topics",
        "DELETE FROM messages",
        "DROP TABLE messages",
        "DROP TABLE topics",
        "ALTER TABLE messages RENAME COLUMN data TO content",
        "UPDATE schema SET schema_version = 99",
        "UPDATE message_definitions SET encoded_message_definition = '][' ",
        "UPDATE metadata SET metadata = '!!int q'",
    )
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(data)
        for _ in range(rng.choice((1, 2))):
            connection.execute(rng.choice(statements))
        connection.commit()
        return connection.serialize()
    except (sqlite3.Error, ValueError, OverflowError):
        return mutate_bytes(data, rng)
    finally:
        connection.close()
