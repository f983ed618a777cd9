"""Frames say what the fleet does, within their resolution; what isn't a frame is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.live import DONE, HEADER, LOADED, LOW, PAUSED, REPLAY, VEHICLE, decode_frame, encode_frame, relabel
from engine.errors import FormatError


def poses(n: int, **columns: Any) -> Any:
    zeros = {name: np.zeros(n) for name in ("x_m", "y_m", "heading_deg", "soc", "state", "task", "loaded", "low")}
    return SimpleNamespace(**{**zeros, **{name: np.asarray(values) for name, values in columns.items()}})


def encoded(given_poses: Any, **changes: Any) -> bytes:
    return encode_frame(given_poses, **{"width_m": 20.0, "height_m": 10.0, "time_s": 1.5, "tick": 1, **changes})


def test_the_layout_is_the_one_the_browser_reads() -> None:
    assert (HEADER.size, VEHICLE.itemsize) == (32, 8)
    data = encoded(
        poses(1, x_m=[20.0], y_m=[5.0], heading_deg=[90.0], soc=[0.5], state=[3], task=[2], loaded=[1], low=[1])
    )
    assert data[:4] == b"WL\x01\x00"
    assert len(data) == 40
    assert list(data[32:]) == [0xFF, 0xFF, 0x00, 0x80, 64, 125, 3, 3 + 4 * 2]


@given(
    x=st.floats(0, 20), y=st.floats(0, 10), heading=st.floats(-720, 720), soc=st.floats(0, 1), state=st.integers(0, 7)
)
def test_a_vehicle_comes_back_within_resolution(x: float, y: float, heading: float, soc: float, state: int) -> None:
    frame = decode_frame(encoded(poses(1, x_m=[x], y_m=[y], heading_deg=[heading], soc=[soc], state=[state])))
    row = frame.vehicles[0]
    assert abs(row["x"] / 65535 * 20 - x) <= 20 / 65535
    assert abs(row["y"] / 65535 * 10 - y) <= 10 / 65535
    turn = (float(row["heading"]) * 360 / 256 - heading + 180) % 360 - 180
    assert abs(turn) <= 0.71
    assert abs(row["soc"] / 250 - soc) <= 1 / 250
    assert row["state"] == state


@given(
    sequence=st.integers(0, 2**32 - 1),
    time_s=st.floats(0, 1e9),
    tick=st.integers(0, 2**31),
    flags=st.sampled_from([0, PAUSED, DONE, REPLAY, PAUSED | REPLAY]),
)
def test_the_header_comes_back(sequence: int, time_s: float, tick: int, flags: int) -> None:
    frame = decode_frame(
        encoded(poses(3), sequence=sequence, time_s=time_s, tick=tick, flags=flags, speed=2.5, asked=0.25)
    )
    assert (frame.sequence, frame.time_s, frame.tick, frame.flags) == (sequence, time_s, tick, flags)
    assert (frame.speed, frame.asked, len(frame.vehicles)) == (2.5, 0.25, 3)
    assert (frame.paused, frame.done, frame.replay) == (bool(flags & 1), bool(flags & 2), bool(flags & 4))


def test_flags_and_unknown_charge() -> None:
    data = encoded(poses(3, loaded=[1, 0, 1], low=[0, 1, 1], soc=[np.nan, -1.0, 0.0]))
    rows = decode_frame(data).vehicles
    assert rows["flags"].tolist() == [LOADED, LOW, LOADED | LOW]
    assert rows["soc"].tolist() == [255, 255, 0]


def test_what_lies_outside_is_drawn_at_the_edge() -> None:
    rows = decode_frame(encoded(poses(2, x_m=[-3.0, 99.0], y_m=[-1.0, 11.0]))).vehicles
    assert rows["x"].tolist() == [0, 65535]
    assert rows["y"].tolist() == [0, 65535]


def test_an_empty_fleet_is_a_frame() -> None:
    assert len(decode_frame(encoded(poses(0))).vehicles) == 0


@pytest.mark.parametrize("cut", [0, 1, 31, 33, 39])
def test_a_torn_frame_is_refused(cut: int) -> None:
    with pytest.raises(FormatError):
        decode_frame(encoded(poses(1))[:cut])


def test_other_versions_are_refused() -> None:
    data = encoded(poses(1))
    for wrong in (b"XX" + data[2:], data[:2] + b"\x02" + data[3:]):
        with pytest.raises(FormatError, match="version"):
            decode_frame(wrong)


def test_relabel_changes_the_flags_alone() -> None:
    data = encoded(poses(2), flags=0)
    assert decode_frame(relabel(data, DONE)).done
    assert relabel(relabel(data, DONE), 0) == data
