"""The same `.rrd` from a RunLog as from the running simulation: the recorder, fed from the log."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from engine.errors import RunError
from engine.replay import looks
from engine.replay.floor_map import View2D
from engine.replay.recorder import RerunRecorder
from engine.replay.recording import Part, Recording
from engine.results.runlog import Log
from engine.results.schema import LIST, TABLES
from engine.results.view import RunView
from engine.scenario.model import Scenario
from engine.world.floor import World
from engine.world.terrain import TerrainWorld

TOTAL_POINTS = 2000
"""Points of each curve of runs beside each other."""
SLICE_ROWS = 400_000
"""Motion rows that are fed at a time, at most as many more as lie between two keyframes."""


def rebuild(
    log: Log, scenario: Scenario, world: World, path: Path | str, *, run_id: str, sample_s: float = 1.0
) -> dict[str, Any]:
    """Write the recording of a logged run to `path`, replacing what is there once it is whole.

    A log cut off by a kill is recorded up to its newest keyframe. Returns the recorder's note for the manifest.
    Raises RunError when the file can't be written; an existing one is then left as it was.
    """
    with (
        _replacing(Path(path)) as part,
        RerunRecorder(part, scenario, world, run_id=run_id, sample_s=sample_s) as recorder,
    ):
        feed(recorder, log)
    return recorder.note()


def rebuild_beside(
    views: Mapping[str, RunView], names: Mapping[str, str], path: Path | str, *, sample_s: float = 1.0
) -> None:
    """Write runs of one floor beside each other to `path`: each below its root, such as /A, all on one timeline.

    names: what a person calls each root's run. Raises RunError when the file can't be written.
    """
    first = next(iter(views.values()))
    floor = View2D(first.world)
    blueprint = looks.blueprint_beside(
        names,
        width_m=floor.width_m,
        height_m=floor.height_m,
        vehicles=first.n,
        ground=isinstance(first.world, TerrainWorld),
    )
    title = f"{first.scenario.title} · {' · '.join(names.values())}"
    with _replacing(Path(path)) as part:
        recording = Recording(part, f"beside-{Path(path).stem}", title, blueprint)
        try:
            runs = [
                RerunRecorder(recording, view.scenario, view.world, run_id=root, sample_s=sample_s, root=root)
                for root, view in views.items()
            ]
            for (root, view), colour in zip(views.items(), looks.RUN_COLOURS, strict=False):
                _send_totals(recording.part(root, view.tick_s), view, names[root], colour)
            recording.flush()  # a viewer draws every floor and curve before the fleets have come
            for run, view in zip(runs, views.values(), strict=True):
                with run:
                    feed(run, view.reader)
        finally:
            recording.close()


def _send_totals(part: Part, view: RunView, name: str, colour: looks.RGBA) -> None:
    """What a run has come to, as curves in its own colour."""
    ticks = np.unique(np.linspace(view.first_tick, view.t_end, TOTAL_POINTS).astype(np.int64))
    progress = view.progress(ticks)
    for total in looks.TOTAL_WORDS:
        path = f"{looks.TOTALS}/{total}"
        part.static(path, rr.SeriesLines(names=name, colors=colour, widths=1.5))
        part.send(path, ticks, rr.Scalars.columns(scalars=np.asarray(progress[total], np.float64)))


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` that takes its place once it is whole."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        yield part
        try:
            part.replace(path)
        except OSError as error:
            raise RunError(f"the recording {path} can't be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


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
