"""Messages between a run's process and the server."""

from __future__ import annotations

import io
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app import wire
from engine.errors import FormatError


class Dripping(io.RawIOBase):
    """A pipe that hands out one byte at a time."""

    def __init__(self, data: bytes) -> None:
        self.data = io.BytesIO(data)

    def read(self, size: int = -1) -> bytes:
        return self.data.read(min(1, size))


@given(st.lists(st.dictionaries(st.text(), st.integers() | st.text() | st.none()), max_size=4), st.binary())
def test_messages_come_back_whole_from_a_dripping_pipe(values: list[dict[str, object]], frame: bytes) -> None:
    stream = Dripping(b"".join(map(wire.pack_json, values)) + wire.pack_frame(frame))
    for value in values:
        message = wire.read_message(stream)  # type: ignore[arg-type]
        assert message is not None
        assert message[0] == wire.JSON
        assert wire.read_json(message[1]) == value
    assert wire.read_message(stream) == (wire.FRAME, frame)  # type: ignore[arg-type]
    assert wire.read_message(stream) is None  # type: ignore[arg-type]


def test_an_end_in_the_middle_is_an_end() -> None:
    whole = wire.pack_json({"op": "ping"})
    for cut in range(len(whole)):
        assert wire.read_message(io.BytesIO(whole[:cut])) is None


@pytest.mark.parametrize(
    "head", [struct.pack("<Ic", 2**31, b"J"), struct.pack("<Ic", 5, b"X"), struct.pack("<Ic", 0, b"J")]
)
def test_what_is_no_message_is_refused(head: bytes) -> None:
    with pytest.raises(FormatError):
        wire.read_message(io.BytesIO(head + b"12345"))


@pytest.mark.parametrize("payload", [b"", b"[1]", b"1", b"{", b"\xff", b"[" * 100_000])
def test_what_is_no_object_is_refused(payload: bytes) -> None:
    with pytest.raises(FormatError):
        wire.read_json(payload)
