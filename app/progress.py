"""Driving a run to its end with a progress bar on stderr; Ctrl-C stops it cleanly."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from app.runner import Run
from engine.units import clock

FLUSH_S = 1.0
CHECKPOINT_S = 60.0
CHUNK_S = 0.25


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM set the event; a second Ctrl-C interrupts at once."""
    stop = threading.Event()

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def drive(run: Run, end_tick: int | None) -> str:
    """Simulates to a tick, or to the scenario's own finish; returns `finished`, or `stopped` after Ctrl-C."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[at]}  {task.fields[rate]}  orders {task.fields[orders]}"),
        TimeRemainingColumn(),
    )
    total = end_tick if end_tick is not None else run.end_tick
    with (
        stop_on_signals() as stop,
        Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar,
    ):
        task = bar.add_task(run.scenario.name, total=total, at="", rate="", orders="")
        begin = flushed = saved = time.monotonic()
        begin_tick, chunk = run.sim.tick, 16
        while not run.done and (end_tick is None or run.sim.tick < end_tick):
            if stop.is_set():
                return "stopped"
            before = time.monotonic()
            room = chunk if end_tick is None else min(chunk, end_tick - run.sim.tick)
            if run.advance(room) == 0:
                break
            now = time.monotonic()
            chunk = max(1, chunk // 2) if now - before > CHUNK_S else min(chunk * 2, 100_000)
            if now - flushed > FLUSH_S:
                run.flush()
                flushed = time.monotonic()
                rate = (run.sim.tick - begin_tick) * run.tick_s / max(1e-9, now - begin)
                counters = run.sim.metrics()
                bar.update(
                    task,
                    completed=run.sim.tick,
                    at=clock(run.sim.tick * run.tick_s),
                    rate=f"{rate:,.0f}×",
                    orders=str(counters["orders_done"]),
                )
            if now - saved > CHECKPOINT_S:
                run.checkpoint()
                saved = time.monotonic()
    return "finished"
