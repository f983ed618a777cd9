"""Frames: what a browser needs to draw the fleet at one instant, in a few bytes per vehicle. Live and replay alike.

Little-endian. Header, 32 bytes: magic `WL` · u8 version · u8 flags · u32 sequence · f64 simulated time [s]
· f32 speed reached · f32 speed asked (0 = as fast as it goes) · u16 vehicles · u16 reserved · u32 tick.
Then per vehicle, 8 bytes: u16 x, u16 y (65535ths of the floor's width and height) · u8 heading (256ths of a turn,
counter-clockwise from east) · u8 state of charge (250ths, 255 unknown) · u8 VehicleState
· u8 flags: loaded, low, and the Task from bit 2 on.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import FormatError
from engine.world.poses import Poses

MAGIC = b"WL"
VERSION = 1
HEADER = struct.Struct("<2sBBIdffHHI")
VEHICLE = np.dtype([("x", "<u2"), ("y", "<u2"), ("heading", "u1"), ("soc", "u1"), ("state", "u1"), ("flags", "u1")])

PAUSED, DONE, REPLAY = 1, 2, 4
LOADED, LOW = 1, 2
TASK_SHIFT = 2
SOC_STEPS = 250
SOC_UNKNOWN = 255


@dataclass(frozen=True)
class Frame:
    """A decoded frame; `vehicles` is a structured array of VEHICLE."""

    flags: int
    sequence: int
    time_s: float
    speed: float
    asked: float
    tick: int
    vehicles: NDArray[Any]

    @property
    def paused(self) -> bool:
        return bool(self.flags & PAUSED)

    @property
    def done(self) -> bool:
        return bool(self.flags & DONE)

    @property
    def replay(self) -> bool:
        return bool(self.flags & REPLAY)


def encode_frame(
    poses: Poses,
    *,
    width_m: float,
    height_m: float,
    time_s: float,
    tick: int,
    sequence: int = 0,
    speed: float = 0.0,
    asked: float = 1.0,
    flags: int = 0,
) -> bytes:
    """The bytes of one frame. Positions outside the floor are drawn at its edge. At most 65,535 vehicles."""
    n = len(poses.x_m)
    rows = np.zeros(n, VEHICLE)
    rows["x"] = np.clip(np.rint(np.asarray(poses.x_m, np.float64) * (65535.0 / width_m)), 0, 65535)
    rows["y"] = np.clip(np.rint(np.asarray(poses.y_m, np.float64) * (65535.0 / height_m)), 0, 65535)
    rows["heading"] = np.rint(np.asarray(poses.heading_deg, np.float64) * (256.0 / 360.0)).astype(np.int64) & 255
    soc = np.asarray(poses.soc, np.float64)
    known = np.isfinite(soc) & (soc >= 0)
    rows["soc"] = np.where(known, np.clip(np.rint(np.where(known, soc, 0) * SOC_STEPS), 0, SOC_STEPS), SOC_UNKNOWN)
    rows["state"] = poses.state
    task = np.asarray(poses.task, np.uint8) << TASK_SHIFT
    rows["flags"] = np.where(poses.loaded, LOADED, 0) | np.where(poses.low, LOW, 0) | task
    head = HEADER.pack(
        MAGIC, VERSION, flags & 255, sequence & 0xFFFFFFFF, float(time_s), float(speed), float(asked), n, 0, int(tick)
    )
    return head + rows.tobytes()


def decode_frame(data: bytes) -> Frame:
    """The frame that these bytes hold; raises FormatError when they hold none."""
    if len(data) < HEADER.size:
        raise FormatError(f"a frame of at least {HEADER.size} bytes was expected; got {len(data)}")
    magic, version, flags, sequence, time_s, speed, asked, n, _, tick = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION:
        raise FormatError(f"a frame of version {VERSION} was expected; got {magic!r} version {version}")
    if len(data) != HEADER.size + n * VEHICLE.itemsize:
        raise FormatError(f"{n} vehicles need {HEADER.size + n * VEHICLE.itemsize} bytes; got {len(data)}")
    vehicles = np.frombuffer(data, VEHICLE, count=n, offset=HEADER.size)
    return Frame(flags, sequence, time_s, speed, asked, tick, vehicles)


def relabel(frame: bytes, flags: int) -> bytes:
    """The same frame with other flags."""
    return frame[:3] + bytes([flags & 255]) + frame[4:]
