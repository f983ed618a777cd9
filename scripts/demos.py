"""Records the demo runs that ship with the program, anew: `python scripts/demos.py`.

Each is an ordinary run: simulated, judged and recorded by the code as it stands.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import assets
from app import runner
from engine.results.runs import Catalogue

DEMOS: dict[str, tuple[str, str, dict[str, object]]] = {
    "demo-ten-orders": ("soochow2022", "The thesis's ten orders", {}),
    "demo-hour-with-breakdowns": (
        "soochow2022-continuous",
        "An hour with delays and breakdowns",
        {
            "time.until_s": 3600.0,
            "fleet.count": 10,
            "faults.delay_probability": 0.02,
            "faults.breakdowns_per_vehicle_day": 12.0,
            "faults.repair_s": 240.0,
        },
    ),
}
LEFT_OUT = ("checkpoints", "writer.lock")


def record(name: str, scenario: str, title: str, changes: dict[str, object], root: Path) -> Path:
    """One run under a fixed name, without what only a resume would need."""
    fresh = runner.prepare(Catalogue(root), runner.asked_scenario(scenario, changes), name=title)
    folder = fresh.rename(fresh.with_name(name))
    manifest = folder / "manifest.json"
    passport = {**json.loads(manifest.read_text(encoding="utf-8")), "run_id": name}
    manifest.write_text(json.dumps(passport), encoding="utf-8")
    runner.warm_up(runner.scenario_of(folder))
    run = runner.Run.new(folder)
    while not run.done:
        run.advance(600)
        run.flush()
    summary = run.close()
    if summary["breaches"]:
        raise SystemExit(f"{name}: the judge found {summary['breaches']} breaches")
    passport = json.loads(manifest.read_text(encoding="utf-8"))
    passport["summary"].pop("run_dir")  # where it was recorded is nobody's business
    manifest.write_text(json.dumps(passport, indent=1), encoding="utf-8")
    for part in LEFT_OUT:
        path = folder / part
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return folder


def main() -> None:
    """Replace assets/demos."""
    target = assets.path("demos")
    with tempfile.TemporaryDirectory() as scratch:
        for name, (scenario, title, changes) in DEMOS.items():
            folder = record(name, scenario, title, changes, Path(scratch))
            shutil.rmtree(target / name, ignore_errors=True)
            shutil.copytree(folder, target / name)
            size = sum(f.stat().st_size for f in (target / name).rglob("*") if f.is_file())
            print(f"{name}: {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
