"""What a run's process and the server say to each other over a pipe.

Each message: u32 length of what follows (little-endian) · u8 type, `J` for UTF-8 JSON or `F` for a frame · payload.
"""

from __future__ import annotations

import json
import struct
from typing import Any, BinaryIO

from engine.errors import FormatError

JSON, FRAME = b"J", b"F"
HEAD = struct.Struct("<Ic")
LIMIT = 16 * 2**20
"""Bytes of the largest message that is believed; 65,535 vehicles need half a megabyte."""


def pack_json(value: dict[str, Any]) -> bytes:
    payload = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
    return HEAD.pack(len(payload) + 1, JSON) + payload


def pack_frame(frame: bytes) -> bytes:
    return HEAD.pack(len(frame) + 1, FRAME) + frame


def read_message(stream: BinaryIO) -> tuple[bytes, bytes] | None:
    """The next (type, payload), or None when the other side is gone. Raises FormatError on what isn't a message."""
    head = _exactly(stream, HEAD.size)
    if head is None:
        return None
    length, kind = HEAD.unpack(head)
    if kind not in (JSON, FRAME) or not 1 <= length <= LIMIT:
        raise FormatError(f"a message of type J or F was expected; got {kind!r} with {length} bytes")
    payload = _exactly(stream, length - 1)
    return None if payload is None else (kind, payload)


def read_json(payload: bytes) -> dict[str, Any]:
    """The object that a JSON payload holds. Raises FormatError."""
    try:
        value = json.loads(payload)
    except (ValueError, RecursionError):
        raise FormatError("a JSON object was expected; got something else") from None
    if not isinstance(value, dict):
        raise FormatError(f"a JSON object was expected; got {type(value).__name__}")
    return value


def _exactly(stream: BinaryIO, count: int) -> bytes | None:
    parts: list[bytes] = []
    while count:
        part = stream.read(count)
        if not part:
            return None
        parts.append(part)
        count -= len(part)
    return b"".join(parts)
