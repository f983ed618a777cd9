"""One `.rrd` while it is written, by the recorder of one run or those of several beside each other."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from engine.errors import RunError
from engine.replay.sink import FileSink, is_finished

APPLICATION = "wattlane"


class Recording:
    """The file. Raises RunError when it can't be written, at the latest in close()."""

    def __init__(self, path: Path | str, recording_id: str, name: str, blueprint: Any) -> None:
        self.path = Path(path)
        self.closed = False
        self._stream = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        if not rr.is_enabled(self._stream):
            raise RunError(f"the recording {self.path.name} can't be written: RERUN=off turns recording off")
        self._sink = FileSink(self.path)
        self._stream.save(self._sink.address)
        self._sink.opened()
        self._stream.send_recording_name(name)
        self._stream.send_blueprint(blueprint, make_active=True, make_default=True)

    def flush(self) -> None:
        """Send what is buffered. Raises RunError when a write has failed."""
        self._stream.flush()
        self._sink.check()

    def close(self) -> None:
        """Finish the file."""
        if self.closed:
            return
        self.closed = True
        self._stream.disconnect()
        self._sink.finish()
        if not is_finished(self.path):
            raise RunError(f"the recording {self.path} could not be finished")

    def part(self, root: str, tick_s: float) -> Part:
        """The entities of one run, below `root` (none for a run alone)."""
        return Part(self._stream, f"{root}/" if root else "", tick_s)


class Part:
    """Where one run's entities go: each path below the run's root, each time on `tick` and `sim_time`."""

    def __init__(self, stream: rr.RecordingStream, prefix: str, tick_s: float) -> None:
        self._stream, self._prefix, self._tick_s = stream, prefix, tick_s
        self._times: tuple[NDArray[np.int64], tuple[Any, ...]] = (np.zeros(0, np.int64), ())

    def static(self, path: str, *what: Any) -> None:
        """What holds for the whole recording."""
        self._stream.log(f"{self._prefix}{path}", *what, static=True, strict=True)

    def send(self, path: str, ticks: NDArray[np.int64], *columns: Iterable[Any]) -> None:
        """Component columns at ticks; nothing when there are none."""
        if not len(ticks):
            return
        # Several entities in turn are sent at the same ticks.
        if ticks is not self._times[0]:
            duration = np.rint(ticks * (self._tick_s * 1e9)).astype("timedelta64[ns]")
            self._times = (ticks, (rr.TimeColumn("tick", sequence=ticks), rr.TimeColumn("sim_time", duration=duration)))
        flat = [column for part in columns for column in part]
        self._stream.send_columns(f"{self._prefix}{path}", self._times[1], flat, strict=True)
