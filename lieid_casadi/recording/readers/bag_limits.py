"""Limit of the inflated size of a bag's chunks, checked before rosbags reads it.

rosbags inflates a chunk at once, whatever its size. Here each chunk is inflated piece by piece
and only counted, which takes little time beside the decoding of the messages.
"""

from __future__ import annotations

import bz2
import struct
import sys
from collections.abc import Callable, Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

from lieid_casadi.recording.readers.registry import beyond_limit

_PIECE = 1 << 20
_CHUNK = 0x06  # MCAP's opcode


def require_bounded(file: Path, limit: int) -> None:
    """Refuse a bag, or a folder with one, whose chunks inflate beyond the limit.

    Parameters
    ----------
    file
        A ``.mcap``, ``.bag`` or ``.zstd`` file, or a folder of them; others have no chunks.
    limit
        Bytes, all chunks together.

    Raises
    ------
    RecordingError
        States the limit and how to raise it.
    """
    parts = sorted(file.iterdir()) if file.is_dir() else [file]
    total = 0
    for part in parts:
        for compression, data in _chunks(part):
            total += _inflated_bytes(data, compression, limit - total)
            if total > limit:
                raise beyond_limit(file, limit)


def _chunks(file: Path) -> Iterator[tuple[str, bytes]]:
    """Yield name of the compression and data of each compressed chunk."""
    suffix = file.suffix.lower()
    if suffix == ".zstd":
        yield "zstd", file.read_bytes()
    elif suffix in (".mcap", ".bag") and file.stat().st_size:
        with file.open("rb") as raw, mmap(raw.fileno(), 0, access=ACCESS_READ) as data:
            try:
                yield from _mcap_chunks(data) if suffix == ".mcap" else _ros1_chunks(data)
            except (struct.error, ValueError):
                return  # damaged: rosbags reports it


def _mcap_chunks(data: mmap) -> Iterator[tuple[str, bytes]]:
    place = 8  # the magic bytes
    while place + 9 <= len(data):
        size = int(struct.unpack_from("<Q", data, place + 1)[0])
        start = place + 9
        if data[place] == _CHUNK:
            # start and end time, size and checksum; name of the compression; its data
            name_size = int(struct.unpack_from("<I", data, start + 28)[0])
            name = data[start + 32 : start + 32 + name_size].decode("ascii")
            yield name, data[start + 40 + name_size : start + size]
        place = start + size


def _ros1_chunks(data: mmap) -> Iterator[tuple[str, bytes]]:
    place = data.find(b"\n") + 1
    while place + 4 <= len(data):
        header_size = int(struct.unpack_from("<I", data, place)[0])
        header = data[place + 4 : place + 4 + header_size]
        start = place + 8 + header_size
        size = int(struct.unpack_from("<I", data, start - 4)[0])
        for name in ("lz4", "bz2"):
            if b"compression=" + name.encode() in header:
                yield name, data[start : start + size]
        place = start + size


def _inflated_bytes(data: bytes, compression: str, limit: int) -> int:
    """Return the inflated size, counted up to just beyond the limit; 0 of damaged data."""
    new = _decompressors().get(compression)
    total = 0
    while new is not None and data and total <= limit:
        stream = new()
        piece = _next_piece(stream, data)
        while piece and total <= limit:
            total += len(piece)
            piece = b"" if stream.eof or stream.needs_input else _next_piece(stream, b"")
        data = stream.unused_data if stream.eof else b""
    return total


def _next_piece(stream: Any, data: bytes) -> bytes:
    """Return up to a mebibyte of output; nothing where the data is damaged."""
    try:
        piece: bytes = stream.decompress(data, max_length=_PIECE)
    except (OSError, ValueError, RuntimeError, EOFError, _zstd().ZstdError):
        return b""
    return piece


def _decompressors() -> dict[str, Callable[[], Any]]:
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    return {
        "bz2": bz2.BZ2Decompressor,
        "lz4": LZ4FrameDecompressor,
        "zstd": _zstd().ZstdDecompressor,
    }


def _zstd() -> Any:
    """Return the module for Zstandard that rosbags uses."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd
