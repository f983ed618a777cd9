"""The log on disk: what was flushed is readable, whatever happens to the writer, and nothing is read twice."""

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import InvariantBroken, RunError
from engine.results.runlog import (
    LogReader,
    MemoryLog,
    RunLogWriter,
    copy_log,
    latest_keyframe,
    read_manifest,
    writer_alive,
)
from engine.results.schema import LIST, TABLES, TEXT

MANIFEST = {"run_id": "r", "tick_s": 1.0, "created": "2026-11-22T10:15:00+00:00"}


def rows(table: str, first: int, n: int) -> dict[str, Any]:
    """n rows that can be told apart: numbers count on from `first`, texts and lists carry them too."""
    out: dict[str, Any] = {}
    for name, kind in TABLES[table].items():
        if kind == TEXT:
            out[name] = [f"row {i}" for i in range(first, first + n)]
        elif kind == LIST:
            out[name] = [list(range(i, i + i % 4)) for i in range(first, first + n)]
        else:
            out[name] = [i % 100 for i in range(first, first + n)]
    return out


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether two tables are equal, column by column."""
    if a.keys() != b.keys():
        return False
    for name in a:
        left, right = (x if isinstance(x, tuple) else (x,) for x in (a[name], b[name]))
        if not all(np.array_equal(p, q) for p, q in zip(left, right, strict=True)):
            return False
    return True


def whole(table: str, n: int) -> dict[str, Any]:
    log = MemoryLog()
    log.write(table, rows(table, 0, n))
    return log.table(table)


def test_every_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST, scenario_toml="name = 'x'\n", keyframe_ticks=1) as writer:
        for name in TABLES:
            writer.write(name, rows(name, 0, 7))
        writer.flush()
        growing = LogReader(tmp_path / "r")
        for name in TABLES:
            assert same(growing.table(name), whole(name, 7)), name
        assert writer.rows == dict.fromkeys(TABLES, 7)
    closed = LogReader(tmp_path / "r")
    for name in TABLES:
        assert same(closed.table(name), whole(name, 7)), name
    assert sorted(p.suffix for p in (tmp_path / "r" / "log").iterdir()) == [".parquet"] * len(TABLES)
    assert closed.manifest["status"] == "finished"
    assert (tmp_path / "r" / "scenario.toml").read_text() == "name = 'x'\n"


@settings(max_examples=30)
@given(sizes=st.lists(st.integers(0, 40), max_size=12), flushes=st.sets(st.integers(0, 11)), small=st.booleans())
def test_batches_may_come_in_any_size(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], flushes: set[int], small: bool
) -> None:
    """A reader that refreshes now and then ends with what was written, each row once."""
    folder = tmp_path_factory.mktemp("run") / "r"
    writer = RunLogWriter(folder, MANIFEST, buffer_rows=10 if small else 1000, segment_bytes=2000)
    reader = LogReader(folder)
    n = 0
    for i, size in enumerate(sizes):
        writer.write("plans", rows("plans", n, size))
        n += size
        if i in flushes:
            writer.flush()
            writer.write("keyframes", {**rows("keyframes", 0, 1), "tick": [i]})  # may rotate
            reader.refresh()
            assert same(reader.table("plans"), whole("plans", n))
    writer.close()
    reader.refresh()
    assert same(reader.table("plans"), whole("plans", n))
    assert reader.generation == 0


def test_handed_out_columns_do_not_change(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST) as writer:
        writer.write("events", rows("events", 0, 5))
        writer.flush()
        reader = LogReader(tmp_path / "r")
        before = reader.table("events")
        kept = {name: values.copy() for name, values in before.items()}
        for i in range(50):
            writer.write("events", rows("events", 5 + i * 7, 7))
            writer.flush()
            reader.refresh()
        assert same(before, kept)
        assert len(reader.table("events")["tick"]) == 355


def test_empty_lists_may_follow_full_ones(tmp_path: Path) -> None:
    """The first batch of a list column is adopted as it was read, and can't be written to."""
    with RunLogWriter(tmp_path / "r", MANIFEST) as writer:
        reader = LogReader(tmp_path / "r")
        for row, cells in enumerate(([3, 4], [], [], [5])):
            writer.write("searches", {**rows("searches", row, 1), "open_places": [cells], "incons_places": [cells]})
            writer.flush()
            reader.refresh()
            values, offsets = reader.table("searches")["incons_places"]
            assert values[offsets[row] : offsets[row + 1]].tolist() == cells


def test_a_torn_tail_is_ignored_until_it_is_complete(tmp_path: Path) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST)
    writer.write("states", rows("states", 0, 30))
    writer.flush()
    segment = next((tmp_path / "r" / "log").glob("states.*.arrows"))
    first = segment.stat().st_size
    writer.write("states", rows("states", 30, 30))
    writer.flush()
    data = segment.read_bytes()
    for cut in sorted({0, 1, 7, 8, 100, first - 1, first, first + 1, first + 9, len(data) - 1, len(data)}):
        segment.write_bytes(data[:cut])
        expected = 60 if cut == len(data) else 30 if cut >= first else 0
        reader = LogReader(tmp_path / "r")
        assert len(reader.table("states")["tick"]) == expected, cut
        segment.write_bytes(data)
        reader.refresh()
        assert same(reader.table("states"), whole("states", 60)), cut
    writer.close()


PROGRAM = """
    import sys
    from engine.results.runlog import RunLogWriter
    from tests.engine.test_runlog import MANIFEST, rows
    writer = RunLogWriter(sys.argv[1], MANIFEST, segment_bytes=4000)
    n = 0
    while True:
        writer.write("motions", rows("motions", n, 50))
        n += 50
        writer.write("keyframes", {**rows("keyframes", 0, 3), "tick": [n, n, n]})
        print(n, flush=True)
"""


def test_a_killed_writer_leaves_a_readable_prefix(tmp_path: Path) -> None:
    """kill -9 in the middle: everything flushed is there, the lock is free, and the run goes on from any row."""
    folder = tmp_path / "r"
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", textwrap.dedent(PROGRAM), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as process:
        assert process.stdout is not None
        flushed = 0
        for line in process.stdout:
            flushed = int(line)
            if flushed >= 2000:
                assert writer_alive(folder)
                process.send_signal(signal.SIGKILL)
                break
    assert not writer_alive(folder)
    reader = LogReader(folder)
    found = len(reader.table("motions")["t0"])
    assert found >= flushed
    assert same(reader.table("motions"), whole("motions", found))
    assert latest_keyframe(reader)["tick"].tolist() in ([found] * 3, [found - 50] * 3)
    assert read_manifest(folder)["status"] == "running"

    with RunLogWriter(folder) as writer:
        assert writer.rows["motions"] == found
        writer.truncate_to({"motions": 1234})
        writer.write("motions", rows("motions", 1234, 66))
    assert same(LogReader(folder).table("motions"), whole("motions", 1300))


@pytest.mark.parametrize("compact", [True, False])
@pytest.mark.parametrize("keep", [0, 1, 49, 50, 51, 120, 299, 300])
def test_a_resumed_run_continues_from_exact_rows(tmp_path: Path, keep: int, compact: bool) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST, segment_bytes=1500)
    for n in range(0, 300, 50):
        writer.write("plans", rows("plans", n, 50))
        writer.write("keyframes", {**rows("keyframes", 0, 1), "tick": [n]})
    writer.close(compact=compact)
    reader = LogReader(tmp_path / "r")
    assert same(reader.table("plans"), whole("plans", 300))

    again = RunLogWriter(tmp_path / "r")
    assert again.rows["plans"] == 300
    again.truncate_to({"plans": keep})
    assert again.rows["plans"] == keep
    again.flush()
    reader.refresh()
    assert same(reader.table("plans"), whole("plans", keep))
    again.write("plans", rows("plans", keep, 40))
    again.flush()
    reader.refresh()
    assert same(reader.table("plans"), whole("plans", keep + 40))
    again.close()
    reader.refresh()
    assert same(reader.table("plans"), whole("plans", keep + 40))
    assert same(LogReader(tmp_path / "r").table("plans"), whole("plans", keep + 40))


def test_a_reader_notices_when_the_log_was_cut_and_went_on_differently(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST) as writer:
        writer.write("blocks", {"tick": [1, 2, 3], "place": [1, 1, 1], "blocked": [1, 0, 1]})
        writer.flush()
        reader = LogReader(tmp_path / "r")
        assert reader.table("blocks")["tick"].tolist() == [1, 2, 3]
        writer.truncate_to({"blocks": 2})
        writer.write("blocks", {"tick": [7], "place": [1], "blocked": [1]})
        writer.flush()
        assert reader.refresh()
        assert reader.table("blocks")["tick"].tolist() == [1, 2, 7]
        assert reader.generation == 1


def test_a_checkpoint_beyond_the_log_is_refused(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST) as writer:
        writer.write("blocks", rows("blocks", 0, 3))
        with pytest.raises(RunError, match="blocks has 3 rows; 4 were expected"):
            writer.truncate_to({"blocks": 4})


def test_a_fork_continues_a_copy_and_leaves_its_parent_alone(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "parent", MANIFEST) as writer:
        writer.write("states", rows("states", 0, 100))
    with RunLogWriter(tmp_path / "fork", {**MANIFEST, "parent": {"run_id": "parent", "tick": 3}}) as _:
        pass
    for file in (tmp_path / "fork" / "log").iterdir():
        file.unlink()
    copy_log(tmp_path / "parent", tmp_path / "fork")
    with RunLogWriter(tmp_path / "fork") as writer:
        writer.truncate_to({"states": 60})
        writer.write("states", rows("states", 60, 5))
    assert same(LogReader(tmp_path / "fork").table("states"), whole("states", 65))
    assert same(LogReader(tmp_path / "parent").table("states"), whole("states", 100))


def test_retention_drops_the_oldest_and_begins_with_a_keyframe(tmp_path: Path) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST, segment_bytes=4000, retention_bytes=20_000, keyframe_ticks=1)
    reader = LogReader(tmp_path / "r")
    rng = np.random.default_rng(1)
    last = 0
    for i in range(120):
        n = 40
        batch = {name: rng.integers(0, 100, n) for name in TABLES["motions"]}
        batch["t0"], batch["t1"] = np.arange(last, last + n), np.arange(last + 1, last + n + 1)
        last += n
        writer.write("motions", batch)
        writer.write("orders", rows("orders", i, 1))
        writer.write("keyframes", {**rows("keyframes", 0, 2), "tick": [last, last]})
        reader.refresh()
        assert reader.table("motions")["t0"][-1] == last - 1
    first = writer.manifest["retention"]["first_tick"]
    assert 0 < first < last
    size = sum(p.stat().st_size for p in (tmp_path / "r" / "log").glob("motions.*"))
    assert size < 30_000
    assert writer.rows["motions"] == 4800
    fresh = LogReader(tmp_path / "r")
    assert fresh.first_tick == first
    assert fresh.table("motions")["t0"].tolist() == list(range(first, last))
    assert len(fresh.table("orders")["tick"]) == 120  # kept whole
    assert len(reader.table("motions")["t0"]) == 4800  # one that followed from the start has it all
    with pytest.raises(RunError, match="were dropped"):
        writer.truncate_to({"motions": 10})
    writer.close()
    closed = LogReader(tmp_path / "r")
    assert closed.first_tick == first
    assert closed.table("motions")["t0"].tolist() == list(range(first, last))
    again = RunLogWriter(tmp_path / "r")
    assert again.rows["motions"] == 4800
    again.truncate_to({**again.rows, "motions": 4790})
    again.close()
    assert LogReader(tmp_path / "r").table("motions")["t0"].tolist() == list(range(first, last - 10))


def test_one_writer_per_run(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST):
        with pytest.raises(RunError, match="being written by another process"):
            RunLogWriter(tmp_path / "r")
        assert writer_alive(tmp_path / "r")
    assert not writer_alive(tmp_path / "r")
    with pytest.raises(RunError, match="already holds a run"):
        RunLogWriter(tmp_path / "r", MANIFEST)
    with pytest.raises(RunError, match="holds no run"):
        RunLogWriter(tmp_path / "other")
    assert not writer_alive(tmp_path / "other")


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST)
    writer.write("motions", rows("motions", 0, 500))
    writer.flush()
    real = os.write
    left = 100

    def full(fd: int, data: bytes) -> int:
        nonlocal left
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = real(fd, bytes(data[:left]))
        left -= done
        return done

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        for _ in range(2):
            writer.write("motions", rows("motions", 0, 0))
            writer._buffers["motions"] or writer.write("motions", rows("motions", 500, 500))
            with pytest.raises(RunError, match=r"the disk is full; what was recorded before is kept$") as told:
                writer.flush()
            assert "\n" not in str(told.value)
            assert same(LogReader(tmp_path / "r").table("motions"), whole("motions", 500))
    writer.flush()  # room again
    assert same(LogReader(tmp_path / "r").table("motions"), whole("motions", 1000))
    writer.close()
    assert same(LogReader(tmp_path / "r").table("motions"), whole("motions", 1000))


def test_a_file_size_limit_is_met_for_real(tmp_path: Path) -> None:
    """The kernel refuses to grow the file; the process says so and what was flushed stays."""
    program = """
        import resource, signal, sys
        from engine.errors import RunError
        from engine.results.runlog import RunLogWriter
        from tests.engine.test_runlog import MANIFEST
        import numpy as np
        from engine.results.schema import TABLES
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        writer = RunLogWriter(sys.argv[1], MANIFEST)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
        rng = np.random.default_rng(1)
        try:
            for i in range(1000):
                writer.write("motions", {name: rng.integers(0, 100, 200) for name in TABLES["motions"]})
                writer.flush()
        except RunError as error:
            print(i, error)
    """
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", textwrap.dedent(program), str(tmp_path / "r")]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=root, timeout=60, check=True)
    assert "would become larger than allowed" in ended.stdout
    flushed = int(ended.stdout.split()[0])
    assert flushed >= 1
    assert len(LogReader(tmp_path / "r").table("motions")["t0"]) == 200 * flushed


def test_a_close_that_fails_keeps_the_segments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST)
    for name in ("motions", "states"):
        writer.write(name, rows(name, 0, 500))

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pq.ParquetWriter, "write_table", full)
        with pytest.raises(RunError, match="the disk is full"):
            writer.close()
    assert not writer_alive(tmp_path / "r")
    assert not list((tmp_path / "r" / "log").glob("*.part"))
    for name in ("motions", "states"):
        assert same(LogReader(tmp_path / "r").table(name), whole(name, 500))
    with RunLogWriter(tmp_path / "r") as again:
        assert again.rows["states"] == 500
    assert same(LogReader(tmp_path / "r").table("states"), whole("states", 500))


def test_an_unwritable_folder_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(RunError, match="a part of its path is not a folder"):
        RunLogWriter(tmp_path / "file" / "r", MANIFEST)


def test_a_crash_between_parquet_and_clean_up_is_harmless(tmp_path: Path) -> None:
    writer = RunLogWriter(tmp_path / "r", MANIFEST)
    writer.write("states", rows("states", 0, 100))
    writer.close(compact=False)
    segments = {p.name: p.read_bytes() for p in (tmp_path / "r" / "log").glob("*.arrows")}
    RunLogWriter(tmp_path / "r").close()
    for name, data in segments.items():
        (tmp_path / "r" / "log" / name).write_bytes(data)
    assert same(LogReader(tmp_path / "r").table("states"), whole("states", 100))
    with RunLogWriter(tmp_path / "r") as again:
        assert again.rows["states"] == 100
        again.write("states", rows("states", 100, 1))
    assert same(LogReader(tmp_path / "r").table("states"), whole("states", 101))


def test_rows_that_do_not_fit_the_schema_are_a_defect(tmp_path: Path) -> None:
    log = MemoryLog()
    with pytest.raises(InvariantBroken, match="did you mean 'blocks'"):
        log.write("block", {})
    with pytest.raises(InvariantBroken, match="'blocked'"):
        log.write("blocks", {"tick": [1], "place": [1]})
    with pytest.raises(InvariantBroken, match="different lengths"):
        log.write("blocks", {"tick": [1], "place": [1, 2], "blocked": [1]})
    with pytest.raises(KeyError, match="motions"):
        log.table("motion")


def test_a_recorder_keeps_copies(tmp_path: Path) -> None:
    ticks = np.array([1, 2, 3], np.int32)
    log = MemoryLog()
    log.write("blocks", {"tick": ticks, "place": ticks, "blocked": np.ones(3)})
    ticks[:] = 0
    assert log.table("blocks")["tick"].tolist() == [1, 2, 3]


def test_a_missing_or_damaged_passport_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="holds no run"):
        LogReader(tmp_path / "nothing")
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(RunError, match="can't be read"):
        LogReader(tmp_path)
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(RunError, match="not a JSON object"):
        LogReader(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps({"log_version": 99}))
    with pytest.raises(RunError, match="log version 99"):
        LogReader(tmp_path)


def test_damage_inside_a_file_is_told(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST) as writer:
        writer.write("states", rows("states", 0, 100))
    (tmp_path / "r" / "log" / "states.parquet").write_bytes(b"PAR1 nonsense PAR1")
    with pytest.raises(RunError, match="is damaged"):
        LogReader(tmp_path / "r").table("states")


def test_keyframes_are_thinned_and_the_newest_is_always_there(tmp_path: Path) -> None:
    with RunLogWriter(tmp_path / "r", MANIFEST, keyframe_ticks=100) as writer:
        reader = LogReader(tmp_path / "r")
        for tick in range(0, 1000, 10):
            writer.write("keyframes", {**rows("keyframes", 0, 2), "tick": [tick, tick]})
            reader.refresh()
            assert latest_keyframe(reader)["tick"].tolist() == [tick, tick]
        assert sorted(set(reader.table("keyframes")["tick"].tolist())) == [*range(0, 1000, 100), 990]
    assert sorted(set(LogReader(tmp_path / "r").table("keyframes")["tick"].tolist())) == [*range(0, 1000, 100), 990]
