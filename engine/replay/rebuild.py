"""The same `.rrd` from a RunLog as from the running simulation: the recorder, fed from the log."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import RunError
from engine.replay.recorder import RerunRecorder
from engine.results.runlog import Log
from engine.results.schema import LIST, TABLES
from engine.scenario.model import Scenario
from engine.world.floor import World

SLICE_ROWS = 400_000
"""Motion rows that are fed at a time, at most as many more as lie between two keyframes."""


def rebuild(
    log: Log, scenario: Scenario, world: World, path: Path | str, *, run_id: str, sample_s: float = 1.0
) -> dict[str, Any]:
    """Write the recording of a logged run to `path`, replacing what is there once it is whole.

    A log cut off by a kill is recorded up to its newest keyframe. Returns the recorder's note for the manifest.
    Raises RunError when the file can't be written; an existing one is then left as it was.
    """
    path = Path(path)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with RerunRecorder(part, scenario, world, run_id=run_id, sample_s=sample_s) as recorder:
            feed(recorder, log)
        try:
            part.replace(path)
        except OSError as error:
            raise RunError(f"the recording {path} can't be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()
    return recorder.note()


def feed(recorder: RerunRecorder, log: Log, *, whole: bool = False) -> None:
    """Give a recorder the rows of a log, slice by slice, each with its keyframe.

    Rows behind the newest keyframe may miss some of their fellows, and are left out unless `whole` says that the log
    was cut at a checkpoint.
    """
    keyframes = log.table("keyframes")
    frame_ticks = np.unique(np.asarray(keyframes["tick"], np.int64))
    tables = {name: log.table(name) for name in TABLES if name != "keyframes"}
    keys = {name: np.asarray(c["t1" if name == "motions" else "tick"], np.int64) for name, c in tables.items()}
    begin = -1
    for end in _cuts(frame_ticks, keys["motions"]):
        for name, columns in tables.items():
            recorder.write(name, rows_at(name, columns, (keys[name] > begin) & (keys[name] <= end)))
        recorder.write("keyframes", rows_at("keyframes", keyframes, np.asarray(keyframes["tick"]) == end))
        begin = end
    if whole or not len(frame_ticks):
        for name, columns in tables.items():
            recorder.write(name, rows_at(name, columns, keys[name] > begin))


def rows_at(table: str, columns: dict[str, Any], keep: NDArray[np.bool_]) -> dict[str, Any]:
    """The rows of a table that a mask keeps; a list column is (values, offsets)."""
    out: dict[str, Any] = {}
    for name, kind in TABLES[table].items():
        if kind == LIST:
            values, offsets = columns[name]
            sizes = np.diff(offsets)
            inside = np.repeat(keep, sizes)
            out[name] = (
                np.asarray(values)[offsets[0] : offsets[-1]][inside],
                np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes[keep])]),
            )
        else:
            out[name] = np.asarray(columns[name])[keep]
    return out


def _cuts(frame_ticks: NDArray[np.int64], ended: NDArray[np.int64]) -> list[int]:
    """Keyframe ticks at which to cut: the first, the newest, and between them every SLICE_ROWS motions or so."""
    cuts: list[int] = []
    before = np.searchsorted(np.sort(ended), frame_ticks, "right")
    taken = 0
    for tick, rows in zip(frame_ticks.tolist(), before.tolist(), strict=True):
        if rows - taken >= SLICE_ROWS or tick in (frame_ticks[0], frame_ticks[-1]):
            cuts.append(tick)
            taken = rows
    return cuts
