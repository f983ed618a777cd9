"""`wattlane study`: a paper's experiments run again, its table beside ours."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.settings import data_folder

if TYPE_CHECKING:
    from app.study import Store


def study(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="A study; without one they are listed.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few maps, or seeds, per case.")] = False,
    maps: Annotated[
        int | None, typer.Option("--maps", metavar="N", help="Maps, or seeds, per case.", show_default="the study's")
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", help="Processes; -1 is one per core.")] = -1,
    seed: Annotated[int, typer.Option("--seed", help="Seed of everything drawn.")] = 11,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the JSON, Markdown and HTML files.")] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Run on a dask cluster: tcp://host:8786.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder for results (also WATTLANE_DATA).", show_default="per user")
    ] = None,
) -> None:
    """Run a paper's experiments, or list the studies. Ctrl-C keeps what is computed; the next run goes on."""
    from app.cli import BREACHES, INTERRUPTED, put, put_json, say
    from app.settings import writable
    from app.study import Asked, Store, checked_study, compute
    from engine.studies.base import Ended

    store = Store(data_folder(data))
    if name is None:
        _list(store, as_json)
        return
    checked_study(name)
    asked = Asked(quick, maps, seed, jobs)
    folder = None if out is None else writable(out.expanduser().resolve())
    with _progress(name) as told:
        try:
            record = compute(name, asked, store, told, say, scheduler)
        except Ended as ended:
            say(f"Study {name} {ended}; the same command goes on.")
            raise typer.Exit(INTERRUPTED) from None
    from app import study_report

    files = [] if folder is None else study_report.write_files(record, folder)
    if as_json:
        put_json({**record, "files": [str(file) for file in files]})
    else:
        put(study_report.markdown(record))
        for file in files:
            say(f"Written: {file}")
        say(f"Kept for the Papers page as {name}/{record['made']['id']}.")
    if record["breaches"]:
        raise typer.Exit(BREACHES)


def _list(store: Store, as_json: bool) -> None:
    from app.cli import put, put_json
    from app.study_report import counted_words
    from engine.studies.base import STUDIES
    from engine.studies.base import study as found_study

    found = []
    for name in STUDIES:
        one = found_study(name)
        results = store.results(name)
        found.append(
            {
                "study": name, "title": one.title, "paper": one.paper, "results": results,
                "experiments": {str(number): what for number, what in one.experiments.items()},
                "maps": {"quick": one.maps[0], "full": one.maps[1]},
            }
        )  # fmt: skip
    if as_json:
        put_json({"studies": found})
        return
    for entry in found:
        put(f"{entry['study']}  {entry['title']} ({entry['paper']})")
        for number, what in entry["experiments"].items():
            put(f"  {number}  {what}")
        for result in entry["results"]:
            made = result["made"]
            put(f"  {result['id']}: {counted_words(made)} per case, seed {made['seed']}, {made['at'][:10]}")


@contextlib.contextmanager
def _progress(name: str) -> Iterator[Any]:
    """A bar on stderr; what it yields takes (done, total, what) and answers False after Ctrl-C."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from app.progress import stop_on_signals

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[what]}"),
    )
    with (
        stop_on_signals() as stop,
        Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar,
    ):
        task = bar.add_task(name, total=None, what="")

        def told(done: int, total: int, what: str) -> bool:
            bar.update(task, completed=done, total=total, what=what)
            return not stop.is_set()

        yield told
