"""Records the arc times that the lesson *Learned time* plays back, anew: `python scripts/learned_time.py`.

An ordinary run of `lian2024` over ten simulated hours; its log's table `arcs` is kept as it is, in one file.
"""

from __future__ import annotations

import json
from importlib.metadata import version

import pyarrow as pa
import pyarrow.parquet as pq

from app.lessons import learned_time as lesson
from engine import MemoryLog
from engine.build import build
from engine.sim.judge import judge
from engine.units import ticks_from_s

HOURS = 10


def main() -> None:
    """Replace the file that the lesson reads."""
    log = MemoryLog()
    simulation = build(lesson.scenario(), recorder=log)
    simulation.advance(ticks_from_s(HOURS * 3600, simulation.tick_s))
    simulation.flush()
    if breaches := judge(log, simulation.scenario, simulation.world):
        raise SystemExit(f"the judge found {len(breaches)} breaches")
    about = {
        "scenario": lesson.SCENARIO,
        "seed": simulation.scenario.seed,
        "planner": simulation.scenario.planner.name,
        "hours": HOURS,
        "places": simulation.world.n_places,
        "vehicles": simulation.scenario.fleet.count,
        "digest": simulation.digest(),
        "version": version("wattlane"),
    }
    table = pa.table(dict(log.table("arcs"))).replace_schema_metadata({lesson.ABOUT: json.dumps(about)})
    lesson.FILE.parent.mkdir(exist_ok=True)
    pq.write_table(table, lesson.FILE, compression="zstd")
    print(f"{lesson.FILE.name}: {table.num_rows} rows, {lesson.FILE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
