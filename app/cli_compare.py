"""`wattlane compare`: two to four runs of one scenario and seed beside each other."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from app.settings import data_folder


def compare(
    run_names: Annotated[
        list[str], typer.Argument(metavar="RUN RUN…", help="Run ids, their beginnings, folders, or `last`; A first.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write one .rrd with the runs below /A, /B …")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder for runs (also WATTLANE_DATA).", show_default="per user")
    ] = None,
) -> None:
    """Compare runs of one scenario and seed. Tells what each came to, and where their motions part."""
    from app import comparing
    from app.cli import find_run, put, put_json
    from engine.errors import BadInput

    folders = [find_run(name, data) for name in run_names]
    manifests = _Manifests(data_folder(data), folders)
    sides = [comparing.side(folder, manifests.of) for folder in folders]
    if reason := comparing.refusal(sides):
        raise BadInput(reason)
    views = {letter: _view(folder) for letter, folder in zip(comparing.LETTERS, folders, strict=False)}
    reads = {letter: _reader(view) for letter, view in views.items()}
    told = comparing.told(sides, reads, comparing.parting(reads), None)
    file = None if out is None else out.expanduser().resolve()
    if file is not None:
        comparing.write_recording(sides, views, file)
    if as_json:
        put_json({**told, "file": None if file is None else str(file)})
        return
    put(table(told))
    if file is not None:
        put(str(file))


class _Manifests:
    """Passports of runs by id, in the folders where the named ones lie and in the data folder."""

    def __init__(self, data: Path, folders: list[Path]) -> None:
        from engine.results.runs import Catalogue

        self._catalogues = [Catalogue(root) for root in dict.fromkeys([*(f.parent for f in folders), data / "runs"])]

    def of(self, run_id: str) -> Mapping[str, Any]:
        from engine.errors import RunError

        for catalogue in self._catalogues:
            if (catalogue.root / run_id / "manifest.json").is_file():
                return catalogue.get(run_id)
        raise RunError(f"there is no run {run_id}")


def _view(folder: Path) -> Any:
    from app.runner import scenario_of, world_of
    from engine.results.runlog import LogReader
    from engine.results.view import RunView

    scenario = scenario_of(folder)
    return RunView(LogReader(folder), scenario, world_of(scenario))


def _reader(view: Any) -> Any:
    return lambda question: question(view)


def table(told: Mapping[str, Any]) -> str:
    """What each run came to, with the difference from A, and where they part."""
    from app.comparing import NUMBERS
    from engine.units import clock

    runs = told["runs"]
    first = runs[0]
    lines = [f"{first['scenario']} · seed {first['seed']} · the first {clock(told['time_s'])} of each run"]
    lines += [f"  {run['letter']}  {run['label']:<24}  {run['run']}" for run in runs]
    lines.append(_line("", [run["letter"] for run in runs], [f"{run['letter']} − A" for run in runs[1:]]))
    for key, words in NUMBERS.items():
        scale = 1000.0 if "[kJ]" in words else 1.0
        values = [None if run[key] is None else run[key] / scale for run in runs]
        lines.append(_line(words, [_cell(value) for value in values], [_off(value, values[0]) for value in values[1:]]))
    return "\n".join([*lines, str(told["parting_text"])])


def _line(words: str, values: list[str], off: list[str]) -> str:
    return f"  {words:<36}" + "".join(f"{cell:>14}" for cell in values) + "".join(f"{cell:>22}" for cell in off)


def _cell(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:,.0f}" if float(value).is_integer() or abs(value) >= 10_000 else f"{value:,.1f}"


def _off(value: float | None, base: float | None) -> str:
    """Difference, and by how many percent; a dash where there is nothing to compare."""
    if value is None or base is None:
        return "–"
    by = value - base
    share = f" ({100 * by / base:+.1f} %)" if base and by else ""
    return f"{'+' if by > 0 else ''}{_cell(by)}{share}"
