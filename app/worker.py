"""The process of one live run: simulates at the pace asked for, answers commands, and reports frames and status.

`python -m app.worker RUN_FOLDER --mode new|resume|fork [--parent FOLDER] [--speed X] [--paused]`. It talks over its
stdin and stdout (app/wire.py). When stdin ends the server is gone: it saves a checkpoint and ends.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, BinaryIO

from app import wire
from app.settings import use_kernel_cache
from engine.errors import BadInput, FormatError, WattlaneError

FRAME_S = 0.05
STATUS_S = 0.5
FLUSH_S = 0.5
CHECKPOINT_S = 60.0
CHUNK_S = 0.03
"""Wall time of one call into the simulation: what a command waits at most, plans aside."""
LONGEST_CHUNK = 1024
"""Ticks: an idle floor simulates a million a second, and must not make a busy one wait for its next command."""
BEHIND_S = 0.25
"""A run further behind its pace than this gives up the lag; the speed reached is shown."""
IDLE_S = 0.25
HEARTBEAT_S = 1.0


class Mailbox:
    """Messages to the server, written by a thread of their own: a slow reader gets the newest frame, never a queue."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream
        self.broken = threading.Event()
        self._messages: list[bytes] = []
        self._frame: bytes | None = None
        self._closing = False
        self._ready = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="mailbox", daemon=True)
        self._thread.start()

    def json(self, value: dict[str, Any]) -> None:
        with self._ready:
            self._messages.append(wire.pack_json(value))
            self._ready.notify()

    def frame(self, frame: bytes) -> None:
        with self._ready:
            self._frame = frame
            self._ready.notify()

    def close(self, timeout_s: float = 5.0) -> None:
        """Sends what is left and ends."""
        with self._ready:
            self._closing = True
            self._ready.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._ready:
                while not (self._messages or self._frame or self._closing):
                    self._ready.wait()
                parts, self._messages = self._messages, []
                if self._frame is not None:
                    parts.append(wire.pack_frame(self._frame))
                    self._frame = None
                if not parts:
                    return
            try:
                self.stream.write(b"".join(parts))
                self.stream.flush()
            except OSError:
                self.broken.set()
                return


def _listen(stream: BinaryIO, inbox: queue.SimpleQueue[dict[str, Any] | None]) -> None:
    """Puts the server's requests into the inbox, and None when it is gone."""
    try:
        while (message := wire.read_message(stream)) is not None:
            with contextlib.suppress(FormatError):
                inbox.put(wire.read_json(message[1]))
    except (FormatError, OSError):
        pass  # a broken pipe and a broken message end the conversation alike
    inbox.put(None)


class LiveRun:
    """The loop: requests, ticks at the pace asked for, frames, status, flushes, checkpoints."""

    def __init__(self, run: Any, mail: Mailbox, inbox: queue.SimpleQueue[Any], *, speed: float, paused: bool) -> None:
        from app.live import encode_frame

        self.run = run
        self.mail = mail
        self.inbox = inbox
        self.encode_frame = encode_frame
        self.asked = speed
        self.paused = paused
        self.steps = 0  # ticks still to be done by a step while paused
        self.ending = ""  # "server gone", "stop" or "done"
        self.sequence = 0
        self.reached = 0.0
        self.size_m = run.sim.world.size_m
        now = time.monotonic()
        self.anchor = (now, run.sim.tick)
        self.window: tuple[float, float] = (now, float(run.sim.tick))
        self.chunk = 1
        self.last_frame = self.last_status = self.last_flush = 0.0
        self.last_checkpoint = now
        self.ahead = 0.0  # part of the next tick that a viewer sees already
        self.drawn: tuple[Any, ...] = ()

    def loop(self) -> str:
        """Runs until it ends; returns why: `done`, `stop` or `server gone`."""
        self.publish(force=True)
        while not self.ending:
            self.requests(self.patience())
            if not self.ending:
                self.simulate()
                self.publish()
                self.keep()
            if self.mail.broken.is_set():
                self.ending = "server gone"
        return self.ending

    # Requests

    def patience(self) -> float:
        """How long to wait for a request before there is something to do."""
        if self.run.catching_up or self.steps:
            return 0.0
        if self.paused:
            return IDLE_S
        if self.asked == 0:
            return 0.0
        pace = self.asked / self.run.tick_s
        next_tick_s = (1.0 - self.due(pace)) / pace
        next_frame_s = self.last_frame + FRAME_S - time.monotonic()
        return max(0.0, min(next_tick_s, next_frame_s))

    def requests(self, wait_s: float) -> None:
        try:
            message = self.inbox.get(timeout=wait_s) if wait_s > 0 else self.inbox.get_nowait()
            while True:
                if message is None:
                    self.ending = "server gone"
                    return
                self.answer(message)
                message = self.inbox.get_nowait()
        except queue.Empty:
            return

    def answer(self, message: dict[str, Any]) -> None:
        number = message.get("id")
        try:
            reply = self.obey(str(message.get("op")), message)
        except BadInput as error:
            reply = {"error": str(error)}
        self.mail.json({**reply, "id": number})
        self.publish(force=True)

    def obey(self, op: str, message: dict[str, Any]) -> dict[str, Any]:
        if op == "ping":
            return {"accepted": True, "tick": self.run.sim.tick}
        if op == "command":
            if self.run.catching_up:
                return {"accepted": False, "reason": "the run is catching up with its log; try again in a moment"}
            given = self.run.sim.submit(message.get("command") or {})
            self.run.flush()
            return {
                "accepted": bool(given.accepted),
                "reason": str(given.reason),
                "tick": int(given.tick),
                "number": int(given.number),
            }
        if op == "pause":
            self.paused, self.steps = True, 0
            if not self.run.catching_up:
                self.run.checkpoint()
        elif op == "play":
            self.paused, self.steps = False, 0
        elif op == "step":
            self.paused, self.ahead = True, 0.0
            self.steps = int(message.get("ticks", 1))
        elif op == "speed":
            self.asked = float(message["factor"])
        elif op == "label":
            self.run.writer.update(name=str(message.get("name", "")))
        elif op == "stop":
            self.ending = "stop"
        else:
            raise BadInput(f"unknown request {op!r}")
        self.settle()
        return {"accepted": True, "reason": "", "tick": self.run.sim.tick, "paused": self.paused, "asked": self.asked}

    def settle(self) -> None:
        """Pacing starts anew from what is shown."""
        now = time.monotonic()
        shown_s = self.ahead * self.run.tick_s / self.asked if self.asked else 0.0
        self.anchor, self.window = (now - shown_s, self.run.sim.tick), (now, self.run.sim.tick + self.ahead)
        if self.paused:
            self.reached = 0.0

    # Ticks

    def simulate(self) -> None:
        run = self.run
        if run.catching_up or self.steps or self.asked == 0:
            self.ahead = 0.0
        if run.catching_up:
            self.timed(min(self.chunk, run.catch_up_to - run.sim.tick))
            self.anchor = (time.monotonic(), run.sim.tick)
        elif self.steps:
            done = self.timed(min(self.chunk, self.steps))
            self.steps = self.steps - done if done else 0
        elif not self.paused:
            if self.asked == 0:
                self.timed(self.chunk)
            else:
                self.keep_pace()
        if run.done:
            self.ahead = 0.0
            self.ending = "done"

    def keep_pace(self) -> None:
        pace = self.asked / self.run.tick_s
        due = self.due(pace)
        if due >= 1:
            self.timed(min(int(due), self.chunk))
            due = self.due(pace)
            if due / pace > BEHIND_S and due > 1:
                self.anchor, due = (time.monotonic(), self.run.sim.tick), 0.0
        self.ahead = min(max(0.0, due), 0.999)

    def due(self, pace: float) -> float:
        """Ticks, with their fraction, between the simulation and where its pace says it should be."""
        begin, tick = self.anchor
        return tick + (time.monotonic() - begin) * pace - self.run.sim.tick

    def timed(self, ticks: int) -> int:
        """Advances, and learns how many ticks fit into CHUNK_S."""
        begin = time.monotonic()
        done = int(self.run.advance(max(1, ticks)))
        took = time.monotonic() - begin
        if took > CHUNK_S:
            self.chunk = max(1, self.chunk // 2)
        elif ticks >= self.chunk and took < CHUNK_S / 2:
            self.chunk = min(self.chunk * 2, LONGEST_CHUNK)
        return done

    # Reports

    def publish(self, force: bool = False) -> None:
        now = time.monotonic()
        flags = self.flags()
        seen = (self.run.sim.tick, self.ahead, flags)
        if force or (now - self.last_frame >= FRAME_S and (seen != self.drawn or now - self.last_frame >= HEARTBEAT_S)):
            self.sequence += 1
            self.mail.frame(self.frame(flags))
            self.last_frame, self.drawn = now, seen
        if force or now - self.last_status >= STATUS_S:
            begin, shown = self.window
            if now - begin >= STATUS_S:
                ticks = self.run.sim.tick + self.ahead - shown
                self.reached = 0.0 if self.paused else max(0.0, ticks) * self.run.tick_s / (now - begin)
                self.window = (now, self.run.sim.tick + self.ahead)
            self.mail.json(self.status())
            self.last_status = now

    def flags(self) -> int:
        from app.live import DONE, PAUSED

        return (PAUSED if self.paused else 0) | (DONE if self.run.done else 0)

    def frame(self, flags: int) -> bytes:
        tick = self.run.sim.tick
        return self.encode_frame(
            self.run.sim.snapshot(self.ahead),
            width_m=self.size_m[0],
            height_m=self.size_m[1],
            time_s=(tick + self.ahead) * self.run.tick_s,
            tick=tick,
            sequence=self.sequence,
            speed=self.reached,
            asked=self.asked,
            flags=flags,
        )

    def status(self) -> dict[str, Any]:
        run = self.run
        counters = run.sim.metrics()
        return {
            "type": "status",
            "phase": "catching up" if run.catching_up else "running",
            "tick": run.sim.tick,
            "sim_s": run.sim.tick * run.tick_s,
            "speed": round(self.reached, 3),
            "asked": self.asked,
            "paused": self.paused,
            "done": run.done,
            "orders": {
                "created": counters["orders_created"],
                "done": counters["orders_done"],
                "open": counters["orders_open"],
            },
            "planner_p95_ms": run.tee.planner_p95_ms,
            "log_tick": run.flushed_tick,
        }

    def keep(self) -> None:
        """Flushes and checkpoints by the clock on the wall, which the simulation never sees."""
        now = time.monotonic()
        if now - self.last_flush >= FLUSH_S and self.run.flushed_tick != self.run.sim.tick:
            self.run.flush()
            self.last_flush = time.monotonic()
        if now - self.last_checkpoint >= CHECKPOINT_S and not self.run.catching_up:
            self.run.checkpoint()
            self.last_checkpoint = time.monotonic()


def begin(arguments: argparse.Namespace, mail: Mailbox) -> Any:
    """The run, opened or begun; says what takes long."""
    first = use_kernel_cache()
    from app.runner import Run, kernel_mark, scenario_of, warm_up

    scenario = scenario_of(arguments.folder)
    if first or use_kernel_cache(kernel_mark(scenario)):
        mail.json({"type": "status", "phase": "compiling kernels, once"})
        warm_up(scenario, few=not first)
    mail.json({"type": "status", "phase": "building"})
    if arguments.mode == "resume":
        mail.json({"type": "status", "phase": "reading the last checkpoint"})
        return Run.resume(arguments.folder)
    if arguments.mode == "fork":
        mail.json({"type": "status", "phase": "simulating the past up to the fork"})
        return Run.fork(arguments.folder, arguments.parent)
    return Run.new(arguments.folder)


def serve(arguments: argparse.Namespace, mail: Mailbox, inbox: queue.SimpleQueue[Any]) -> None:
    run = begin(arguments, mail)
    live = LiveRun(run, mail, inbox, speed=arguments.speed, paused=arguments.paused)
    why = live.loop()
    if why == "server gone":
        run.interrupt("the dashboard ended while the run was going on")
        return
    mail.json({**live.status(), "phase": "closing the log and judging the run", "paused": True})
    run.close("finished" if why == "done" else "stopped")
    mail.json({**live.status(), "phase": "ended", "paused": True})


def sentence(error: Exception) -> str:
    """What a person reads when a run can't go on."""
    if isinstance(error, OSError):
        if error.errno == errno.ENOSPC:
            return "the disk is full; make room and resume the run"
        return f"{error.strerror or error}: {error.filename}" if error.filename else str(error.strerror or error)
    return str(error)


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="app.worker", description="The process of one live run.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mode", choices=("new", "resume", "fork"), default="new")
    parser.add_argument("--parent", type=Path)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--paused", action="store_true")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    arguments = parse(argv)
    # Whatever prints must not reach the pipe to the server.
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    inbox: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: inbox.put(None))
    mail = Mailbox(out)
    # Unbuffered, since a thread that still reads must not hold a lock when the interpreter ends.
    requests = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
    threading.Thread(target=_listen, args=(requests, inbox), name="listener", daemon=True).start()
    try:
        serve(arguments, mail, inbox)
    except (WattlaneError, OSError) as error:
        text = sentence(error)
        print(text, file=sys.stderr)
        mail.json({"type": "status", "phase": "failed", "failure": text})
        mail.close()
        return 1
    mail.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
