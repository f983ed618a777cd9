"""Two to four runs of one scenario and seed beside each other: which belong together, where they part, how they fare.

Runs are named A, B, C, D in the order in which they are given; each is compared with A.
"""

from __future__ import annotations

import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.errors import BadInput, WattlaneError

if TYPE_CHECKING:
    from app.runs import RunManager
    from engine.results.divergence import Divergence
    from engine.results.view import RunView
    from engine.scenario import Scenario

LETTERS = "ABCD"
FEWEST, MOST = 2, len(LETTERS)
HOW_MANY = "two to four runs were expected"
FREE = frozenset({"name", "title", "description", "paper", "planner", "log"})
"""What two runs of one scenario may differ in, beside how long they go on."""
CURVES: dict[str, str] = {"orders_done": "orders done", "energy_j": "energy drawn", "waiting_s": "waiting"}
"""Of `RunView.progress`, what the difference strip shows."""
NUMBERS: dict[str, str] = {
    "orders_done": "orders done",
    "orders_open": "orders open",
    "energy_j": "energy drawn [kJ]",
    "energy_per_order_j": "energy per order [kJ]",
    "waiting_s": "waiting, all vehicles [s]",
    "order_time_mean_s": "order time, mean of the last hour [s]",
    "stranded": "vehicles stranded",
}
KEPT = 32
_STAYS = ("waits", "picks up", "delivers", "charges", "rests", "is broken down", "is paused")


Read = Callable[[Callable[["RunView"], Any]], Any]
"""read(question) asks a run's view."""


@dataclass(frozen=True)
class Side:
    """One of the runs. origin: the run that its past began in, itself unless it was forked."""

    run_id: str
    manifest: Mapping[str, Any]
    scenario: Scenario
    origin: str


# Which belong together


def side(folder: Path, manifest_of: Callable[[str], Mapping[str, Any]]) -> Side:
    """The run of a folder. manifest_of: the passport of a run, this one's or an ancestor's; raises RunError."""
    file = folder / "scenario.toml"
    stamp = file.stat().st_mtime_ns if file.is_file() else 0
    manifest = manifest_of(folder.name)
    origin, parent, seen = folder.name, manifest.get("parent"), {folder.name}
    while parent and str(parent["run_id"]) not in seen:
        origin = str(parent["run_id"])
        seen.add(origin)
        try:
            parent = manifest_of(origin).get("parent")
        except WattlaneError:  # deleted since: its id still tells whose descendants belong together
            parent = None
    return Side(folder.name, manifest, _scenario(folder, stamp), origin)


@lru_cache(maxsize=64)
def _scenario(folder: Path, stamp: int) -> Scenario:
    from app.runner import scenario_of

    return scenario_of(folder)


def refusal(sides: Sequence[Side]) -> str:
    """Why these runs can't be compared, in a sentence; empty when they can.

    Runs of one scenario and seed under different planners can; so can a run and its forks, whatever was changed.
    """
    if not FEWEST <= len(sides) <= MOST:
        return f"{HOW_MANY}; got {len(sides)}"
    names = [one.run_id for one in sides]
    for number, name in enumerate(names):
        if name in names[:number]:
            return f"different runs were expected; got {name} twice"
    first = sides[0]
    for letter, other in zip(LETTERS[1:], sides[1:], strict=False):
        what = _difference(first, other)
        if what:
            return (
                f"runs of one scenario and seed, or forks of one run, were expected; in A and {letter} "
                f"({first.run_id} and {other.run_id}) {what}"
            )
    return ""


def _difference(one: Side, other: Side) -> str:
    """The first thing that two runs don't share and should; empty when there is none."""
    if one.origin == other.origin:
        return ""
    names = [s.manifest.get("scenario") for s in (one, other)]
    if names[0] != names[1]:
        return f"the scenario is {names[0]} and {names[1]}"
    a, b = (s.scenario.model_dump(mode="json", exclude=set(FREE)) for s in (one, other))
    if a["seed"] != b["seed"]:
        return f"the seed is {a['seed']} and {b['seed']}"
    for dump in (a, b):
        dump["time"].pop("until_s", None)
    for section in a:
        if a[section] == b[section]:
            continue
        if not isinstance(a[section], dict) or not isinstance(b[section], dict):
            return f"{section} is {_short(a[section])} and {_short(b[section])}"
        key = next(k for k in {**a[section], **b[section]} if a[section].get(k) != b[section].get(k))
        return f"{section}.{key} is {_short(a[section].get(key))} and {_short(b[section].get(key))}"
    return ""


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}…"


# Where they part, and how they fare


def parting(reads: Mapping[str, Read]) -> dict[str, Any] | None:
    """Where runs first do not do the same, and what the first vehicle that differs does in each; None when nowhere.

    reads: by letter. `each` has the tick at which each of the others parts from A, or None.
    """
    from engine.results.divergence import first_divergence

    logs = {letter: read(lambda view: view.reader) for letter, read in reads.items()}
    each: dict[str, Divergence | None] = {
        letter: first_divergence(logs["A"], log) for letter, log in logs.items() if letter != "A"
    }
    found = [one for one in each.values() if one is not None]
    if not found:
        return None
    first = min(found, key=lambda one: one.tick)
    tick_s = reads["A"](lambda view: view.tick_s)
    vehicle = first.vehicles[0]
    return {
        "tick": first.tick,
        "time_s": first.tick * tick_s,
        "vehicles": list(first.vehicles),
        "vehicle": vehicle,
        "does": {letter: read(lambda view: doing(view, vehicle, first.tick)) for letter, read in reads.items()},
        "each": {letter: None if one is None else one.tick for letter, one in each.items()},
    }


def doing(view: RunView, vehicle: int, tick: int) -> str:
    """What a vehicle does at a tick, in words: `drives to (4, 5)`."""
    from engine.results.divergence import trail
    from engine.types import PRIMITIVE_0
    from engine.world.network import NetworkWorld

    rows = trail(view.reader, tick, tick + 1)
    own = rows[rows[:, 1] == vehicle]
    if not len(own):
        return "has ended"
    kind, begin, end = (int(value) for value in own[-1, 2:5])
    place = view.world.place_name(end)
    if isinstance(view.world, NetworkWorld):
        place = view.world.label(end).partition(" at ")[0]  # a node's place in the mesh is not asked for
    if kind < PRIMITIVE_0:
        return f"{_STAYS[kind]} at {place}"
    heading = view.world.graph.heading_deg[own[-1, 6]]
    verb = f"turns to {heading:g}° at {place}" if begin == end else f"drives to {place}"
    return f"{verb}, loaded" if own[-1, 7] else verb


def told(
    sides: Sequence[Side], reads: Mapping[str, Read], found: Mapping[str, Any] | None, time_s: float | None
) -> dict[str, Any]:
    """Everything about the runs at a time, None for where the shortest ends. found: of `parting`."""
    ends = [read(lambda view: view.t_end * view.tick_s) for read in reads.values()]
    at = min(ends) if time_s is None else min(time_s, max(ends))
    runs = []
    for (letter, read), one, end_s in zip(reads.items(), sides, ends, strict=True):
        about = {key: one.manifest.get(key) for key in ("scenario", "planner", "objective", "seed", "status", "alive")}
        came_to = read(lambda view: numbers(view, at))
        runs.append({"letter": letter, "run": one.run_id, "label": label(one), "end_s": end_s, **about, **came_to})
    said = parting_words(found, min(ends))
    return {"time_s": at, "end_s": min(ends), "parting": found, "parting_text": said, "runs": runs}


def numbers(view: RunView, time_s: float) -> dict[str, Any]:
    """What a run has come to at a time, by the keys of NUMBERS."""
    at = min(max(0.0, time_s / view.tick_s), float(view.t_end))
    known = view.kpis(at) | {"waiting_s": float(view.progress([at])["waiting_s"][0])}
    return {key: known[key] for key in NUMBERS}


def label(one: Side | Mapping[str, Any]) -> str:
    """What a run is among the others: its planner, with the objective where that is not time."""
    manifest = one.manifest if isinstance(one, Side) else one
    objective = manifest.get("objective")
    return f"{manifest['planner']}, least {objective}" if objective not in (None, "", "time") else manifest["planner"]


def parting_words(found: Mapping[str, Any] | None, end_s: float) -> str:
    """Where runs part, for a person."""
    from engine.units import clock

    if end_s <= 0:
        return "Not every run has begun yet."
    if found is None:
        return f"The motions are the same until {clock(end_s)}, where the shortest run ends."
    alike: dict[str, list[str]] = {}
    for letter, does in found["does"].items():
        alike.setdefault(does, []).append(letter)
    told = "; ".join(f"in {_joined(letters)} it {does}" for does, letters in alike.items())
    if len(alike) == 1:
        told += ", but not for equally long"
    when = f"{clock(found['time_s'])} (tick {found['tick']})"
    return f"The motions first differ at {when}, vehicle {found['vehicle']}: {told}."


def _joined(letters: Sequence[str]) -> str:
    return " and ".join([", ".join(letters[:-1]), letters[-1]] if len(letters) > 1 else letters)


# In the dashboard


_partings: OrderedDict[tuple[Any, ...], dict[str, Any] | None] = OrderedDict()
_lock = threading.Lock()


class Comparisons:
    """The comparisons of a dashboard."""

    def __init__(self, manager: RunManager) -> None:
        self.manager = manager

    def sides(self, run_ids: Sequence[str]) -> list[Side]:
        """The runs with these ids. Raises NoSuchRun."""
        return [side(self.manager.folder(run_id), self._manifest) for run_id in run_ids]

    def _manifest(self, run_id: str) -> Mapping[str, Any]:
        """The passport; a run is alive with its process, which may not have taken the log's lock yet."""
        manifest = self.manager.manifest(run_id)
        return {**manifest, "alive": manifest["alive"] or self.manager.worker_alive(run_id)}

    def checked(self, run_ids: Sequence[str]) -> list[Side]:
        """The runs, when they can be compared. Raises BadInput with the reason, NoSuchRun."""
        sides = self.sides(run_ids)
        if reason := refusal(sides):
            raise BadInput(reason)
        return sides

    def reads(self, sides: Sequence[Side]) -> dict[str, Read]:
        """What asks each run's view, by its letter."""

        def reader(run_id: str) -> Read:
            return lambda question: self.manager.read(run_id, question)

        return {letter: reader(one.run_id) for letter, one in zip(LETTERS, sides, strict=False)}

    def parting(self, sides: Sequence[Side]) -> dict[str, Any] | None:
        """As the function of that name, kept while no run has grown."""
        reads = self.reads(sides)
        ends = [read(lambda view: view.t_end) for read in reads.values()]
        key = tuple(zip((self.manager.folder(one.run_id) for one in sides), ends, strict=True))
        with _lock:
            if key in _partings:
                _partings.move_to_end(key)
                return _partings[key]
        found = parting(reads)
        with _lock:
            _partings[key] = found
            while len(_partings) > KEPT:
                _partings.popitem(last=False)
        return found

    def ends(self, sides: Sequence[Side]) -> list[float]:
        """Where each run ends, in seconds."""
        return [float(read(lambda view: view.t_end * view.tick_s)) for read in self.reads(sides).values()]

    def told(self, sides: Sequence[Side], time_s: float | None) -> dict[str, Any]:
        """Everything about the runs at a time, None for where the shortest ends."""
        return told(sides, self.reads(sides), self.parting(sides), time_s)

    def curves(self, sides: Sequence[Side], points: int) -> dict[str, Any]:
        """t_s (m,) up to where the longest run ends, and of each letter the CURVES (m,), cut where its run ends."""
        import numpy as np

        ends = self.ends(sides)
        longest = max(ends)
        t_s = np.linspace(0.0, longest, points)
        runs = {}
        for (letter, read), end_s in zip(self.reads(sides).items(), ends, strict=True):
            known = read(lambda view: view.progress(t_s / view.tick_s))
            runs[letter] = {name: np.where(t_s <= end_s + 1e-9, known[name], np.nan) for name in CURVES}
        return {"t_s": t_s, "runs": runs}

    def recording(self, sides: Sequence[Side]) -> Path:
        """A temporary `.rrd` with all runs, each below its letter; whoever asked removes it."""
        views = {letter: self.manager.view(one.run_id) for letter, one in zip(LETTERS, sides, strict=False)}
        with tempfile.NamedTemporaryFile(prefix="wattlane-", suffix=".rrd", delete=False) as made:
            path = Path(made.name)
        try:
            write_recording(sides, views, path)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return path


def write_recording(sides: Sequence[Side], views: Mapping[str, RunView], path: Path) -> None:
    """Writes the runs to one `.rrd`. Raises RunError."""
    from engine.replay.rebuild import rebuild_beside

    names = {letter: f"{letter} {label(one)}" for letter, one in zip(LETTERS, sides, strict=False)}
    rebuild_beside(views, names, path)
