"""Studies: a paper's experiments run again, its table beside ours.

A study is a frozen value with a name, its paper, its experiments, and `run`. Work is cut into cells (one map of one
case of one experiment); a cell is a function of plain values, is run by joblib on any number of cores or on a cluster,
and is kept in a folder, so that a run that was ended goes on where it was. A cell of other code is never used.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import signal
import sys
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import stats

from engine.errors import InvariantBroken, RunError, ScenarioError, WattlaneError, unknown_name

STUDIES: dict[str, str] = {
    "xu2025": "engine.studies.xu2025:Xu2025",
    "lian2024": "engine.studies.lian2024:Lian2024",
    "zhang2021": "engine.studies.zhang2021:Zhang2021",
    "wang2019": "engine.studies.wang2019:Wang2019",
    "soochow2022": "engine.studies.soochow2022:Soochow2022",
}

Cell = dict[str, Any]
Progress = Callable[[int, int, str], bool | None]
"""Told (cells done, cells in all, what); answers False to end the run, keeping the cells that are done."""

NOT_IN_CELLS = ("replay", "studies")
"""Rooms of the engine whose code can't change what a cell finds."""
VERSIONS_KEPT = 2
"""Cells of so many versions of the code stay in a folder."""


class Ended(WattlaneError):
    """A study was ended before its last cell; what is done is kept."""


@dataclass(frozen=True, slots=True)
class Settings:
    """maps: per case, the study's own number by default · quick: few maps · folder: where cells are kept, if anywhere

    · backend: joblib's, such as `loky`, or `dask` inside a `joblib.parallel_config` · cold: kernels have still to be
    compiled, so one cell of each experiment is run before the others, and by one process.
    """

    quick: bool = False
    maps: int | None = None
    seed: int = 11
    folder: Path | None = None
    backend: str = "loky"
    cold: bool = False

    def __post_init__(self) -> None:
        if self.maps is not None and not 1 <= self.maps <= 100_000:
            raise ScenarioError(f"between 1 and 100000 maps per case were expected, got {self.maps}")
        if self.seed < 0:
            raise ScenarioError(f"a seed of zero or more was expected, got {self.seed}")


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


FIGURE_KINDS = ("lines", "bars", "scatter", "histogram", "table", "gantt", "floor")


@dataclass(frozen=True, slots=True)
class Figure:
    """Data of one figure as plain values; `kind` says how it is drawn, and so what `data` holds.

    lines, bars, scatter: `series`, each {name, x, y} and optionally half (of the interval about y), style (`dash`),
    points (False for a mere line);
    `bands`, each {name, x, low, high}; x_title, y_title, log_y · histogram: `series`, each {name, values}; x_title ·
    table: columns, rows · gantt: `bars`, each {row, begin, end, name}; x_title · floor: rows (text, the lowest first,
    `@` an obstacle), paths (name → vehicles → cells [x, y]), captions (name → text) · all: `note`, a sentence.
    """

    name: str
    title: str
    kind: str
    data: Mapping[str, Any]

    def __post_init__(self) -> None:
        if self.kind not in FIGURE_KINDS:
            raise InvariantBroken(f"figure {self.name}: {unknown_name('kind', self.kind, FIGURE_KINDS)}")


@dataclass(frozen=True, slots=True)
class Result:
    """A study's answer. parameters: the one set that produced all rows · plans, breaches: how many plans the judge saw,
    and what it found · notes: why ours differs, and how each side was counted.
    """

    study: str
    title: str
    paper: str
    experiments: Mapping[int, str]
    parameters: Mapping[str, Any]
    rows: tuple[Row, ...]
    figures: tuple[Figure, ...]
    plans: int
    breaches: int
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

    @property
    def maps(self) -> tuple[int, int]:
        """Maps (or repetitions) per case: of a quick run, and of a full one."""
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


def counted(study: Study) -> str:
    """What a study's `maps` are, in the plural: maps, unless it has a `counted` that says otherwise."""
    return str(getattr(study, "counted", "maps"))


class Beside(NamedTuple):
    """Runs of a scenario under several planners, to be seen beside each other.

    planners: each `name` or `name:objective` · length: such as `10h`, the scenario's own when empty · seed: the
    scenario's own when None · changes: dotted key → value over the scenario.
    """

    scenario: str
    planners: tuple[str, ...]
    length: str = ""
    seed: int | None = None
    changes: Mapping[str, Any] = {}


def beside(study: Study, record: Mapping[str, Any], row: Mapping[str, Any] | None = None) -> Beside | None:
    """The runs that a row of a result is about, or without a row the study's methods; None where there are none.

    A study whose methods run in a scenario has a `beside(record, row)` that says so. record: a result as plain values.
    """
    asked = getattr(study, "beside", None)
    return None if asked is None else asked(record, row)


# -- cells ------------------------------------------------------------------------------------------------------------


def run_cells(
    work: Callable[[Cell], Cell], cells: Sequence[Cell], settings: Settings, progress: Progress, jobs: int = 1
) -> list[Cell]:
    """The result of every cell, in order; those found in the folder aren't computed again. Raises Ended.

    work: a function of a module, so that other processes find it · jobs: processes, −1 for one per core.
    """
    code = code_version(work.__module__)
    folder = None if settings.folder is None else _folder_of(settings.folder, code)
    results: list[Cell | None] = [_kept(folder, cell) for cell in cells]
    missing = [i for i, result in enumerate(results) if result is None]
    done = len(cells) - len(missing)
    if progress(done, len(cells), "cells kept from before" if done else "starting") is False:
        raise Ended(f"ended after {done} of {len(cells)} cells")
    first = _first_of_each(cells, missing) if settings.cold and jobs != 1 and settings.backend == "loky" else []
    later = [i for i in missing if i not in first]
    for which, processes in ((first, 1), (later, jobs)):
        found = _results(work, [(i, cells[i]) for i in which], code, settings.backend, processes)
        try:
            for i, result in found:
                results[i] = result
                _keep(folder, cells[i], result)
                done += 1
                if progress(done, len(cells), str(cells[i].get("what", ""))) is False:
                    raise Ended(f"ended after {done} of {len(cells)} cells")
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # joblib's, about cells that nobody waits for any more
                found.close()
    return [result for result in results if result is not None]


def _first_of_each(cells: Sequence[Cell], missing: Sequence[int]) -> list[int]:
    """One missing cell of each experiment."""
    found: dict[Any, int] = {}
    for i in missing:
        found.setdefault(cells[i].get("experiment"), i)
    return list(found.values())


def _results(
    work: Callable[[Cell], Cell], numbered: Sequence[tuple[int, Cell]], code: str, backend: str, jobs: int
) -> Generator[Any, None, None]:
    if backend == "loky" and (jobs == 1 or len(numbered) < 2):
        for i, cell in numbered:
            yield i, work(cell)
        return
    from joblib import Parallel, delayed

    # another backend is the one of the `parallel_config` around this, with its client
    more = {"backend": backend, "initializer": _leave_ending_to_the_first} if backend == "loky" else {}
    pool = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, **more)
    with _ctrl_c_waits():  # a process that is still starting would end with a traceback
        found = pool(delayed(_numbered)(work, i, cell, code) for i, cell in numbered)
    try:
        yield from found
    finally:
        found.close()


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Holds Ctrl-C back; processes started meanwhile inherit that and never hear it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_ending_to_the_first() -> None:
    """Ctrl-C reaches every process of a terminal; the one that began the others ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")


def _numbered(work: Callable[[Cell], Cell], i: int, cell: Cell, code: str) -> tuple[int, Cell]:
    if code_version(work.__module__) != code:
        raise RunError("a worker has other code than this program: it was changed meanwhile, or its version differs")
    return i, work(cell)


@cache
def code_version(module: str) -> str:
    """Names the code that a cell's result depends on: the solving rooms of the engine, one study's module, numpy."""
    engine = Path(__file__).resolve().parent.parent
    own = getattr(sys.modules.get(module) or import_module(module), "__file__", None)
    files = [file for file in engine.rglob("*.py") if file.relative_to(engine).parts[0] not in NOT_IN_CELLS]
    found = hashlib.sha256(f"{np.__version__} {module}".encode())
    for file in sorted(files):
        found.update(file.relative_to(engine).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    if own is not None:
        found.update(Path(own).read_bytes())
    return found.hexdigest()[:16]


def _folder_of(folder: Path, code: str) -> Path:
    """Where the cells of this code are kept; those of old code are removed."""
    own = folder / code
    own.mkdir(parents=True, exist_ok=True)
    os.utime(own)
    others = sorted((f for f in folder.iterdir() if f.is_dir()), key=lambda f: f.stat().st_mtime, reverse=True)
    for old in others[VERSIONS_KEPT:]:
        shutil.rmtree(old, ignore_errors=True)
    return own


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


def by_quantity(rows: Sequence[Row]) -> list[Row]:
    """The rows of a quantity below each other, quantities in the order in which they first come."""
    first: dict[tuple[int, str], int] = {}
    for r in rows:
        first.setdefault((r.experiment, r.quantity), len(first))
    return sorted(rows, key=lambda r: (r.experiment, first[r.experiment, r.quantity]))


# -- writing ----------------------------------------------------------------------------------------------------------


def as_plain(result: Result) -> dict[str, Any]:
    """The whole result as JSON's values; numbers that aren't become null."""
    found: dict[str, Any] = _plain(asdict(result))
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
