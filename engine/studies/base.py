"""Studies: a paper's experiments run again, its table beside ours.

A study is a frozen value with a name, its paper, its experiments, and `run`. Work is cut into cells (one map of one
case of one experiment); a cell is a function of plain values, is run by joblib on any number of cores, and is kept in a
folder, so that a run that was ended goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy import stats

from engine.errors import ScenarioError, WattlaneError, unknown_name

STUDIES: dict[str, str] = {
    "xu2025": "engine.studies.xu2025:Xu2025",
}

Cell = dict[str, Any]
Progress = Callable[[int, int, str], bool | None]
"""Told (cells done, cells in all, what); answers False to end the run, keeping the cells that are done."""


class Ended(WattlaneError):
    """A study was ended before its last cell; what is done is kept."""


@dataclass(frozen=True, slots=True)
class Settings:
    """maps: per case, the study's own number by default · quick: few maps · folder: where cells are kept, if anywhere

    · backend: joblib's, such as `loky`, or `dask` inside a `joblib.parallel_config`.
    """

    quick: bool = False
    maps: int | None = None
    seed: int = 11
    folder: Path | None = None
    backend: str = "loky"

    def __post_init__(self) -> None:
        if self.maps is not None and self.maps < 1:
            raise ScenarioError(f"at least one map per case was expected, got {self.maps}")


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table.

    paper: the value or range printed, None where the paper prints none · ours ± half_width: mean and 95 % interval of n
    maps · verdict: `inside` when the interval meets the paper's value or range, `outside`, or `–` · off: signed
    distance of the mean from the paper's nearest value, 0 within its range.
    """

    experiment: int
    quantity: str
    case: str
    unit: str
    paper: tuple[float, float] | None
    ours: float
    half_width: float | None
    n: int
    verdict: str
    off: float | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """Data of one figure as plain values; `kind` says how it is meant (lines, floor)."""

    name: str
    title: str
    kind: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Result:
    """A study's answer. parameters: the one set that produced all rows."""

    study: str
    title: str
    paper: str
    parameters: Mapping[str, Any]
    rows: tuple[Row, ...]
    figures: tuple[Figure, ...]
    notes: tuple[str, ...] = field(default=())


class Study(Protocol):
    """The contract."""

    @property
    def name(self) -> str:
        """Its word on the command line."""
        ...

    @property
    def title(self) -> str:
        """What it is about, in one line."""
        ...

    @property
    def paper(self) -> str:
        """Authors, year, title."""
        ...

    @property
    def experiments(self) -> Mapping[int, str]:
        """Number → what is compared."""
        ...

    def run(self, settings: Settings, progress: Progress, jobs: int = 1) -> Result:
        """All experiments. Raises Ended when progress says so."""
        ...


def study(name: str) -> Study:
    """A study by name. Raises ScenarioError with the nearest name."""
    if name not in STUDIES:
        raise ScenarioError(unknown_name("study", name, STUDIES))
    module, _, attribute = STUDIES[name].partition(":")
    found: Study = getattr(import_module(module), attribute)()
    return found


# -- cells ------------------------------------------------------------------------------------------------------------


def run_cells(
    work: Callable[[Cell], Cell], cells: Sequence[Cell], settings: Settings, progress: Progress, jobs: int = 1
) -> list[Cell]:
    """The result of every cell, in order; those found in the folder aren't computed again. Raises Ended."""
    results: list[Cell | None] = [_kept(settings.folder, cell) for cell in cells]
    missing = [i for i, result in enumerate(results) if result is None]
    done = len(cells) - len(missing)
    if progress(done, len(cells), "cells kept from before") is False:
        raise Ended(f"ended after {done} of {len(cells)} cells")
    for i, result in _results(work, [(i, cells[i]) for i in missing], settings.backend, jobs):
        results[i] = result
        _keep(settings.folder, cells[i], result)
        done += 1
        if progress(done, len(cells), str(cells[i].get("what", ""))) is False:
            raise Ended(f"ended after {done} of {len(cells)} cells")
    return [result for result in results if result is not None]


def _results(work: Callable[[Cell], Cell], numbered: Sequence[tuple[int, Cell]], backend: str, jobs: int) -> Any:
    if jobs == 1 and backend == "loky":
        return ((i, work(cell)) for i, cell in numbered)
    from joblib import Parallel, delayed

    return Parallel(n_jobs=jobs, backend=backend, return_as="generator_unordered", batch_size=4)(
        delayed(_numbered)(work, i, cell) for i, cell in numbered
    )


def _numbered(work: Callable[[Cell], Cell], i: int, cell: Cell) -> tuple[int, Cell]:
    return i, work(cell)


def _file(folder: Path, cell: Cell) -> Path:
    text = json.dumps(cell, sort_keys=True)
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def _kept(folder: Path | None, cell: Cell) -> Cell | None:
    if folder is None:
        return None
    try:
        found = json.loads(_file(folder, cell).read_text("utf-8"))
    except (OSError, ValueError):
        return None  # never written, or cut off: computed again
    result = found.get("result") if isinstance(found, dict) and found.get("cell") == cell else None
    return result if isinstance(result, dict) else None


def _keep(folder: Path | None, cell: Cell, result: Cell) -> None:
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    file = _file(folder, cell)
    part = file.with_suffix(f".{os.getpid()}.part")
    part.write_text(json.dumps({"cell": cell, "result": result}), "utf-8")
    part.replace(file)


# -- statistics -------------------------------------------------------------------------------------------------------


def mean_interval(values: Sequence[float]) -> tuple[float, float | None]:
    """Mean, and half the width of its 95 % interval by Student's t (None below two values)."""
    if not values:
        return math.nan, None
    mean = float(np.mean(values))
    if len(values) < 2:
        return mean, None
    return mean, float(stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values)))


def row(
    experiment: int, quantity: str, case: str, values: Sequence[float],
    paper: float | tuple[float, float] | None = None, unit: str = "%", note: str = "",
) -> Row:  # fmt: skip
    """A line of the table from the maps' values, with its verdict."""
    mean, half = mean_interval(values)
    if paper is None or not values:
        return Row(experiment, quantity, case, unit, None, mean, half, len(values), "–", None, note)
    low, high = paper if isinstance(paper, tuple) else (paper, paper)
    off = mean - high if mean > high else min(0.0, mean - low)
    inside = abs(off) <= (half or 0.0)
    verdict = "inside" if inside else "outside"
    return Row(experiment, quantity, case, unit, (low, high), mean, half, len(values), verdict, off, note)


# -- writing ----------------------------------------------------------------------------------------------------------


def to_json(result: Result) -> str:
    """The whole result; numbers that aren't become null."""
    return json.dumps(_plain(asdict(result)), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_markdown(result: Result) -> str:
    """The table and the parameters."""
    lines = [f"# {result.title}", "", result.paper, ""]
    lines += [
        "| experiment | quantity | case | paper | ours | 95 % | n | verdict |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in result.rows:
        low, high = r.paper or (0.0, 0.0)
        paper = "–" if r.paper is None else f"{low:g}" if low == high else f"{low:g}–{high:g}"
        half = "–" if r.half_width is None else f"±{r.half_width:.2f}"
        verdict = r.verdict if r.off is None else f"{r.verdict} ({r.off:+.2f})" if r.off else r.verdict
        note = f" ({r.note})" if r.note else ""
        words = [
            str(r.experiment),
            f"{r.quantity}{note}, {r.unit}",
            r.case,
            paper,
            f"{r.ours:.2f}",
            half,
            str(r.n),
            verdict,
        ]
        lines.append(f"| {' | '.join(words)} |")
    lines += ["", "One parameter set for all rows:", ""]
    lines += [f"- {name}: {value}" for name, value in result.parameters.items()]
    if result.notes:
        lines += ["", *[f"- {note}" for note in result.notes]]
    return "\n".join(lines) + "\n"


def write(result: Result, folder: Path) -> tuple[Path, Path]:
    """`<study>.json` (rows, parameters, figures' data) and `<study>.md` in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    files = folder / f"{result.study}.json", folder / f"{result.study}.md"
    files[0].write_text(to_json(result), "utf-8")
    files[1].write_text(to_markdown(result), "utf-8")
    return files
