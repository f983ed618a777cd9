"""Saving a run and going on from it: named arrays (npz) and plain values (JSON), never pickle.

A checkpoint belongs to one version of the code: another version refuses it, for its digest could differ.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.errors import RunError
from engine.orders.book import OrderBook
from engine.traffic import Claims, Steps

if TYPE_CHECKING:
    from engine.sim.simulation import Simulation

ARRAYS = "state.npz"
PLAIN = "state.json"
_OWN = ("home", "holder", "must_charge", "charge_later", "charger_out", "try_at", "blocked", "clock", "linger")
_PLAIN = (
    "thresholds", "needs_plan", "queue", "commands", "done", "deadlocks", "block_version", "retry", "plan_all",
    "together_at", "together_pause",
)  # fmt: skip


@cache
def code_version() -> str:
    """A hash over the engine's sources."""
    root = Path(__file__).resolve().parents[1]
    seen = hashlib.blake2b(digest_size=8)
    for path in sorted(root.rglob("*.py")):
        seen.update(path.relative_to(root).as_posix().encode())
        seen.update(path.read_bytes())
    return seen.hexdigest()


def save(sim: Simulation, folder: Path) -> None:
    """Write a checkpoint folder; complete or not there at all. Flush the log first."""
    arrays: dict[str, Any] = {}
    for group in ("fleet", "steps", "claims"):
        for name, array in getattr(sim, group)._asdict().items():
            arrays[f"{group}.{name}"] = array
    for name, array in sim.learning.times._asdict().items():
        arrays[f"arcs.{name}"] = array
    for name in ("full", "top_up", "sufficient", "good"):
        arrays[f"levels.{name}"] = getattr(sim.levels, name)
    for name in _OWN:
        arrays[f"own.{name}"] = getattr(sim, name)
    arrays["view.is_charger"], arrays["view.is_rest"] = sim.rest_places()
    for name, value in sim.memory.items():
        if isinstance(value, np.ndarray):
            arrays[f"memory.{name}"] = value
    plain = {
        "code": code_version(),
        "tick": sim.tick,
        "scenario": sim.scenario.to_toml(),
        "own": {name: getattr(sim, name) for name in _PLAIN},
        "reasons": {str(k): v for k, v in sim.reasons.items()},
        "not_before": {str(k): v for k, v in sim.not_before.items()},
        "book": sim.book.to_plain(),
        "source": sim.source.to_plain(),
        "faults": sim.faults.to_plain(),
        "ledger": sim.ledger.to_plain(),
        "learn_at": sim.learning.next_tick,
        "planner_rng": sim.parts.planner_rng.bit_generator.state,
        "memory": {k: v for k, v in sim.memory.items() if not isinstance(v, np.ndarray)},
    }
    write(folder, arrays, plain)


def write(folder: Path, arrays: Mapping[str, Any], plain: Mapping[str, Any]) -> None:
    """Write a checkpoint folder; complete or not there at all. Raises RunError."""
    part = folder.with_name(folder.name + ".part")
    try:
        part.mkdir(parents=True, exist_ok=True)
        np.savez(part / ARRAYS, **arrays)
        (part / PLAIN).write_text(json.dumps(plain), encoding="utf-8")
        os.replace(part, folder)
    except OSError as why:
        raise RunError(f"the checkpoint {folder.name} could not be written: {why.strerror or why}") from why


def read_plain(folder: Path) -> dict[str, Any]:
    """The plain part of a checkpoint. Raises RunError when it is damaged or of another version."""
    try:
        plain: dict[str, Any] = json.loads((folder / PLAIN).read_text(encoding="utf-8"))
    except (OSError, ValueError) as why:
        raise RunError(f"the checkpoint {folder.name} can't be read: {why}") from why
    if plain.get("code") != code_version():
        raise RunError(
            f"the checkpoint {folder.name} was made by another version of the engine ({plain.get('code')}, this is "
            f"{code_version()}); run the scenario again instead"
        )
    return plain


def read_arrays(folder: Path) -> dict[str, Any]:
    """The arrays of a checkpoint. Raises RunError when it is damaged."""
    try:
        with np.load(folder / ARRAYS, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, KeyError) as why:
        raise RunError(f"the checkpoint {folder.name} can't be read: {why}") from why


def restore(sim: Simulation, folder: Path, plain: dict[str, Any]) -> None:
    """Bring a freshly built simulation of the same scenario to the checkpoint's tick."""
    arrays = read_arrays(folder)
    for name, array in sim.fleet._asdict().items():
        array[...] = arrays[f"fleet.{name}"]
    for name, array in sim.learning.times._asdict().items():
        array[...] = arrays[f"arcs.{name}"]
    sim.learning.next_tick = plain["learn_at"]
    sim.steps = Steps(*(arrays[f"steps.{name}"] for name in Steps._fields))
    sim.claims = Claims(*(arrays[f"claims.{name}"] for name in Claims._fields))
    for name in ("full", "top_up", "sufficient", "good"):
        getattr(sim.levels, name)[...] = arrays[f"levels.{name}"]
    for name in _OWN:
        getattr(sim, name)[...] = arrays[f"own.{name}"]
    for mine, theirs in zip(sim.rest_places(), (arrays["view.is_charger"], arrays["view.is_rest"]), strict=True):
        mine[...] = theirs
    own = plain["own"]
    sim.thresholds.update(own.pop("thresholds"))
    for name, value in own.items():
        setattr(sim, name, value)
    sim.tick = plain["tick"]
    sim.reasons = {int(k): v for k, v in plain["reasons"].items()}
    sim.not_before = {int(k): v for k, v in plain["not_before"].items()}
    sim.set_book(OrderBook.from_plain(plain["book"]))
    sim.source.restore(plain["source"])
    sim.faults.restore(plain["faults"])
    sim.sink.filled[:] = 0
    sim.ledger.restore(plain["ledger"])
    sim.parts.planner_rng.bit_generator.state = plain["planner_rng"]
    sim.memory = {
        **plain["memory"],
        **{name[7:]: array for name, array in arrays.items() if name.startswith("memory.")},
    }
