"""The command line, `wattlane`. Answers go to stdout, everything else to stderr.

Exit codes: 0 done · 1 ran, but the judge found breaches (or a run could not go on) · 2 bad input.
Imports of weight stand inside the commands: `--help` answers at once.
"""

from __future__ import annotations

import errno
import gc
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.cli_compare import compare
from app.cli_study import study
from app.settings import DEFAULT_PORT, DEFAULT_SCENARIO, LOOPBACK, Settings, data_folder
from engine.errors import BadInput, RunError, WattlaneError

if TYPE_CHECKING:
    from app.runner import Run
    from engine.scenario import Scenario

DONE, BREACHES, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
COMPILING = "Compiling kernels, once: this takes up to a minute …"

app = typer.Typer(
    name="wattlane",
    help="An energy-aware multi-AGV warehouse: run it, operate it live, record it, replay it.",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
runs_app = typer.Typer(help="Recorded runs: list, show, rm.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(runs_app, name="runs")

DataOption = Annotated[
    Path | None,
    typer.Option("--data", help="Folder for runs and scenarios (also WATTLANE_DATA).", show_default="per user"),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="Run id, its beginning, a run's folder, or `last`.")]


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def put(text: str) -> None:
    print(text, flush=True)


def put_json(value: Any) -> None:
    from app.jsonable import plain

    put(json.dumps(plain(value), ensure_ascii=False, allow_nan=False))


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            put(f"wattlane {version('wattlane')}")
        except PackageNotFoundError:
            put("wattlane (not installed)")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    _version_wanted: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        dashboard(token=os.environ.get("WATTLANE_TOKEN"))


# Dashboard


@app.command()
def dashboard(
    scenario: Annotated[
        str | None, typer.Option("--scenario", help="Scenario that runs on start: name or TOML file.")
    ] = None,
    host: Annotated[str, typer.Option("--host", help="Address to listen on.")] = LOOPBACK,
    port: Annotated[int, typer.Option("--port", help="Port to listen on.")] = DEFAULT_PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Don't open a browser.")] = False,
    token: Annotated[
        str | None,
        typer.Option("--token", envvar="WATTLANE_TOKEN", help="What a client must show; `new` makes one."),
    ] = None,
    allow_host: Annotated[
        list[str] | None, typer.Option("--allow-host", help="Another name under which the dashboard is reached.")
    ] = None,
    data: DataOption = None,
) -> None:
    """Open the dashboard (what `wattlane` alone does)."""
    _serve(_settings(scenario, host, port, no_browser, token, allow_host, data), page_path=None)


def _settings(
    scenario: str | None,
    host: str,
    port: int,
    no_browser: bool,
    token: str | None,
    allow_host: list[str] | None,
    data: Path | None,
) -> Settings:
    from app.settings import make_token

    return Settings(
        data=data_folder(data),
        host=host,
        port=port,
        token=make_token() if token == "new" else token or None,
        allowed_hosts=tuple(allow_host or ()),
        scenario=scenario or DEFAULT_SCENARIO,
        open_browser=not no_browser,
    )


def _serve(settings: Settings, page_path: str | None) -> None:
    import logging

    from app.settings import use_kernel_cache

    logging.basicConfig(level=logging.WARNING, format="wattlane: %(message)s")
    use_kernel_cache()  # lessons search in this process
    from app.server import serve

    try:
        serve(settings, page_path=page_path, say=say)
    except KeyboardInterrupt:
        say("The dashboard has ended.")


# Runs


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="Scenario: a built-in or imported name, or a TOML file.")],
    planner: Annotated[
        str | None, typer.Option("--planner", help="Planner: prioritized, quickest, aco …; `?` names all.")
    ] = None,
    objective: Annotated[str | None, typer.Option("--objective", help="What plans minimise: time or energy.")] = None,
    dispatcher: Annotated[
        str | None, typer.Option("--dispatcher", help="Who takes which order: nearest, insertion …")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override, such as fleet.count=12.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of everything random.")] = None,
    until: Annotated[
        str | None, typer.Option("--until", help="Simulated time to stop at: 3600s, 90min, 8h, 01:30:00.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder in which the run's folder is made.")] = None,
    rrd: Annotated[bool, typer.Option("--rrd/--no-rrd", help="Write a Rerun recording.")] = True,
    name: Annotated[str, typer.Option("--name", help="Your label for the run.")] = "",
    as_json: JsonOption = False,
    data: DataOption = None,
) -> None:
    """Run a scenario as fast as it goes, and judge it."""
    from app import runner
    from app.library import Library
    from app.settings import scenarios_folder, use_kernel_cache, writable

    use_kernel_cache()
    chosen = {} if dispatcher is None else {"dispatch.policy": dispatcher}
    asked = runner.asked_scenario(
        scenario,
        {**overrides_of(set_ or []), **chosen},
        seed=seed,
        planner=planner,
        objective=objective,
        library=Library(scenarios_folder(data_folder(data))),
    )
    end_tick = _end_tick(asked, until)
    from engine.results.runs import Catalogue, checked_name

    root_folder = out.expanduser().resolve() if out else data_folder(data) / "runs"
    folder = runner.prepare(Catalogue(writable(root_folder)), asked, name=checked_name(name))
    if use_kernel_cache(runner.kernel_mark(asked)):
        say(COMPILING)
    going = runner.Run.new(folder, rerun=rrd)
    _finish(going, end_tick, as_json)


@app.command()
def resume(
    run_name: RunArgument,
    until: Annotated[str | None, typer.Option("--until", help="Simulated time to stop at.")] = None,
    as_json: JsonOption = False,
    data: DataOption = None,
) -> None:
    """Go on with a run from its last checkpoint. It was interrupted, failed, or was stopped."""
    from app import runner
    from app.runs import RESUMABLE
    from app.settings import use_kernel_cache

    folder = find_run(run_name, data)
    status = _catalogue_entry(folder)["status"]
    if status not in RESUMABLE:
        raise RunError(f"run {folder.name} is {status} and can't be resumed")
    use_kernel_cache()
    if use_kernel_cache(runner.kernel_mark(runner.scenario_of(folder))):
        say(COMPILING)
    going = runner.Run.resume(folder)
    _finish(going, _end_tick(going.scenario, until), as_json)


def _end_tick(scenario: Scenario, until: str | None) -> int | None:
    """Tick at which a headless run stops, None at the scenario's own finish."""
    from app import runner
    from engine.units import clock, seconds

    if until is not None:
        return runner.checked_until(scenario, seconds(until))
    default_s = runner.default_until_s(scenario)
    if default_s is None:
        return None
    say(f"{scenario.name} never ends: stopping after {clock(default_s)} of simulated time (--until says otherwise).")
    return runner.checked_until(scenario, default_s)


def _finish(going: Run, end_tick: int | None, as_json: bool) -> None:
    """Drives a run to its end with a progress bar, closes it, and prints what came of it."""
    from app.progress import drive
    from app.runner import kernel_mark
    from app.settings import kernels_compiled

    gc.freeze()  # modules and kernels stay: nothing to look through again and again
    status = drive(going, end_tick)
    if status == "stopped":
        say(f"Stopped at tick {going.sim.tick}; `wattlane resume {going.folder.name}` goes on.")
    summary = going.close(status)
    kernels_compiled(kernel_mark(going.scenario))
    if as_json:
        put_json(summary)
    else:
        put(summary_text(summary))
    if status == "stopped":
        raise typer.Exit(INTERRUPTED)
    if summary["breaches"]:
        raise typer.Exit(BREACHES)


def summary_text(summary: dict[str, Any]) -> str:
    """A run's summary for a person."""
    from engine.units import clock

    breaches = summary["breaches"]
    verdict = "not judged" if breaches is None else "legal" if not breaches else f"{breaches} breaches"
    rate = summary["sim_s"] / summary["wall_s"] if summary["wall_s"] else 0.0
    ways = summary["metrics"].get("ways_beside")
    lines = [
        f"{summary['scenario']} · {summary['planner']} · seed {summary['seed']} · {summary['run_id']}",
        f"  simulated {clock(summary['sim_s'])} in {summary['wall_s']:.1f} s ({rate:,.0f}×)",
        f"  orders    {summary['orders_done']} of {summary['orders_created']} done · stranded {summary['stranded']}",
        f"  energy    {summary['energy_j'] / 3600:,.1f} Wh",
        *([] if ways is None else [f"  ways      {ways_text(ways)}"]),
        f"  judge     {verdict}",
        f"  digest    {summary['digest']}",
        f"  folder    {summary['run_dir']}",
    ]
    return "\n".join(lines)


def ways_text(ways: dict[str, Any]) -> str:
    """A router's ways beside other methods', for a person."""
    if not ways["ways"]:
        return "none to compare"
    told = [f"{name} {one['length_m']:.1f} m in {one['cpu_ms']:.2f} ms" for name, one in ways["methods"].items()]
    return f"{' · '.join(told)} (mean length, median CPU of the first {ways['ways']})"


def overrides_of(pairs: list[str]) -> dict[str, object]:
    """`--set` texts as a mapping. Raises BadInput for one without `=`."""
    found: dict[str, object] = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not key.strip():
            raise BadInput(f"--set: key=value was expected, such as fleet.count=12; got {pair!r}")
        found[key.strip()] = value.strip()
    return found


def find_run(name: str, data: Path | None) -> Path:
    """The folder of a run given by id, by the beginning of one, by path, or as `last`. Raises RunError."""
    import assets
    from engine.results.runs import Catalogue

    as_path = Path(name).expanduser()
    if (as_path / "manifest.json").is_file():
        return as_path.resolve()
    own = Catalogue(data_folder(data) / "runs")
    entries = own.list()
    if name == "last":
        if not entries:
            raise RunError(f"there are no runs in {own.root}")
        return own.root / str(entries[0]["run_id"])
    for catalogue, listed in ((own, entries), (Catalogue(assets.path("demos")), None)):
        ids = [str(entry["run_id"]) for entry in (catalogue.list() if listed is None else listed)]
        matches = [name] if name in ids else [run_id for run_id in ids if name and run_id.startswith(name)]
        if len(matches) > 1:
            raise RunError(f"{name!r} begins {len(matches)} runs: {', '.join(matches[:5])}")
        if matches:
            return catalogue.root / matches[0]
    raise RunError(f"there is no run {name!r} in {own.root}")


def _catalogue_entry(folder: Path) -> dict[str, Any]:
    from engine.results.runs import Catalogue

    return Catalogue(folder.parent).get(folder.name)


@runs_app.command("list")
def runs_list(as_json: JsonOption = False, data: DataOption = None) -> None:
    """List recorded runs, newest first."""
    from engine.results.runs import Catalogue
    from engine.units import clock

    entries = Catalogue(data_folder(data) / "runs").list()
    if as_json:
        put_json({"runs": entries})
        return
    if not entries:
        say(f"There are no runs in {data_folder(data) / 'runs'}; `wattlane run soochow2022` makes one.")
    for entry in entries:
        breaches = entry.get("breaches")
        verdict = "" if breaches is None else "legal" if not breaches else f"{breaches} breaches"
        length = clock(float(entry.get("ticks") or 0) * float(entry.get("tick_s") or 1.0))
        size = float(entry.get("size_bytes") or 0) / 1e6
        words = [entry["run_id"], entry.get("planner", ""), entry.get("status", ""), length, f"{size:.1f} MB", verdict]
        put("  ".join(str(word) for word in [*words, entry.get("name") or ""] if word))


@runs_app.command("show")
def runs_show(run_name: RunArgument, as_json: JsonOption = False, data: DataOption = None) -> None:
    """Show one run's passport."""
    entry = _catalogue_entry(find_run(run_name, data))
    if as_json:
        put_json(entry)
        return
    for key, value in entry.items():
        put(f"{key:12} {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)}")


@runs_app.command("rm")
def runs_rm(
    run_names: Annotated[list[str], typer.Argument(metavar="RUN…", help="Runs to remove for good.")],
    data: DataOption = None,
) -> None:
    """Remove runs and everything they recorded."""
    import assets
    from engine.results.runs import Catalogue

    folders = [find_run(name, data) for name in run_names]
    for folder in folders:
        if folder.is_relative_to(assets.path("demos")):
            raise RunError(f"{folder.name} came with the program and can't be removed")
    for folder in folders:
        Catalogue(folder.parent).delete(folder.name)
        say(f"Removed {folder.name}.")


@app.command()
def replay(
    run_name: RunArgument,
    native: Annotated[bool, typer.Option("--native", help="Open Rerun's own viewer instead.")] = False,
    port: Annotated[int, typer.Option("--port", help="Port to listen on.")] = DEFAULT_PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Don't open a browser.")] = False,
    data: DataOption = None,
) -> None:
    """Open a recorded run in the dashboard's replay page."""
    import assets

    folder = find_run(run_name, data)
    if native:
        from engine.replay.viewer import open_native

        open_native(_recording_of(folder, None))
        return
    root_folder = data_folder(data)
    if folder.parent.name == "runs" and folder.parent != assets.path("demos"):
        root_folder = folder.parent.parent
    elif folder.parent != assets.path("demos"):
        raise BadInput(f"{folder} lies outside a data folder's runs/; `--native` opens it in Rerun")
    settings = Settings(data=root_folder, port=port, scenario=None, open_browser=not no_browser)
    _serve(settings, page_path=f"/replay?run={folder.name}")


def _recording_of(folder: Path, target: Path | None) -> Path:
    """The run's `.rrd`, made from the log when it has none; copied to the target when one is given."""
    import shutil

    from app import runner

    file = folder / "run.rrd"
    if not file.is_file():
        say("Making the recording from the log …")
        scenario = runner.scenario_of(folder)
        runner.rebuild_recording(folder, scenario, runner.world_of(scenario))
    if target is None:
        return file
    shutil.copyfile(file, target)
    return target


@app.command()
def judge(
    what: Annotated[
        str, typer.Argument(metavar="RUN|FILE", help="A plan file, or a run: id, its beginning, folder, or `last`.")
    ],
    as_json: JsonOption = False,
    data: DataOption = None,
) -> None:
    """Judge a recorded run or a plan file. Every rule is worked out anew, by code that shares nothing with planners."""
    from app import runner

    if Path(what).expanduser().is_file():
        verdict = _judged_plan(Path(what).expanduser())
    elif what.endswith(".json"):
        raise BadInput(f"{what}: there is no such file")
    else:
        folder = find_run(what, data)
        scenario = runner.scenario_of(folder)
        verdict = runner.judge_folder(folder, scenario, runner.world_of(scenario))
    breaches = verdict["breaches"]
    if as_json:
        put_json(verdict)
    else:
        for breach in breaches[:50]:
            put(runner.breach_text(breach))
        if len(breaches) > 50:
            put(f"… and {len(breaches) - 50} more (--json lists all)")
        name = verdict.get("run_id") or verdict["file"]
        put(f"{name}: {'legal, no breaches' if not breaches else f'{len(breaches)} breaches'}")
    if breaches:
        raise typer.Exit(BREACHES)


def _judged_plan(file: Path) -> dict[str, Any]:
    from dataclasses import asdict

    from app.jsonable import plain
    from engine.scenario.plan_file import read_plan
    from engine.sim.judge import judge_plan_file

    return {"file": file.name, "breaches": [plain(asdict(breach)) for breach in judge_plan_file(read_plan(file))]}


@app.command()
def export(
    run_name: RunArgument,
    to: Annotated[str, typer.Option("--to", help="csv, parquet or rrd.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder (or, for rrd, file) to write to.")] = None,
    data: DataOption = None,
) -> None:
    """Export a run's tables or recording."""
    from engine.errors import unknown_name

    if to not in ("csv", "parquet", "rrd"):
        raise BadInput(unknown_name("format", to, ("csv", "parquet", "rrd")))
    folder = find_run(run_name, data)
    if to == "rrd":
        target = (out or Path(f"{folder.name}.rrd")).expanduser()
        put(str(_recording_of(folder, target / f"{folder.name}.rrd" if target.is_dir() else target).resolve()))
        return
    from app.export import write_tables

    target = (out or Path(f"{folder.name}-{to}")).expanduser()
    files = write_tables(folder, target, to)
    put(str(target.resolve()))
    say(f"{len(files)} tables written.")


@app.command()
def validate(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A scenario in TOML, or a built-in or imported name.")],
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override.")] = None,
    data: DataOption = None,
) -> None:
    """Check a scenario: form, floor, energy. Says what fails, where, and what was expected."""
    from app import runner
    from app.library import Library
    from app.settings import scenarios_folder

    library = Library(scenarios_folder(data_folder(data)))
    scenario = runner.asked_scenario(file, overrides_of(set_ or []), library=library)
    findings = runner.findings_of(scenario)
    for finding in findings:
        put(f"{finding.level:8} {finding.check}: {finding.text}")
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(BAD_INPUT)
    put(f"{scenario.name} is valid")


@app.command()
def solve(
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="A MovingAI .map file.")],
    scen_file: Annotated[Path, typer.Argument(metavar="SCEN", help="A MovingAI .scen file of that map.")],
    planner: Annotated[
        str, typer.Option("--planner", help="cbs, ecbs, time-window, prioritized; astar, eea for one vehicle.")
    ],
    agents: Annotated[
        int | None, typer.Option("--agents", min=1, help="The first so many rows.", show_default="all rows")
    ] = None,
    objective: Annotated[
        str | None, typer.Option("--objective", help="time or energy.", show_default="the planner's")
    ] = None,
    w: Annotated[float | None, typer.Option("--w", help="cbs, ecbs: cost at most w times the optimum.")] = None,
    time_limit: Annotated[
        str, typer.Option("--time-limit", metavar="TIME", help="End the search after 90s, 5min …; `none` never does.")
    ] = "60s",
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A planner's parameter, such as tie=lifo.")
    ] = None,
    mass: Annotated[str, typer.Option("--mass", help="Kilograms, of all vehicles or in turn: 2000,2200.")] = "1000",
    energy: Annotated[
        list[str] | None, typer.Option("--energy", metavar="KEY=VALUE", help="A number of xu2025, such as mu=0.02.")
    ] = None,
    heading: Annotated[
        str, typer.Option("--heading", help="At the start: east, north, west, south, or each its cheapest.")
    ] = "cheapest",
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the plan, for `judge`.")] = None,
    trace: Annotated[
        Path | None, typer.Option("--trace", metavar="FILE", help="Write what the search did: .json or .npz.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a MovingAI instance and judge the plan."""
    from app import solving
    from app.settings import kernels_compiled, use_kernel_cache
    from engine.units import seconds

    solving.check_targets(out, trace)
    asked = solving.Asked(
        map_file,
        scen_file,
        planner,
        agents=agents,
        objective=objective,
        w=w,
        parameters=overrides_of(set_ or []),
        masses_kg=solving.numbers(mass, "--mass"),
        energy=solving.energies(overrides_of(energy or [])),
        heading=heading,
        time_limit_s=None if time_limit == "none" else seconds(time_limit),
    )
    instance, mark = solving.read(asked), f"compiled-{planner}"
    if use_kernel_cache(mark):
        say(COMPILING)
    solving.warm_up(asked)
    kernels_compiled(mark)
    answer = solving.solve(asked, instance, trace=trace is not None)
    written = []
    if out is not None and answer.plan is not None:
        out.write_text(answer.plan.text(), "utf-8")
        written.append(out)
    if trace is not None and answer.trace:
        solving.write_trace(answer.trace, trace)
        written.append(trace)
    if as_json:
        put_json(answer.summary)
    else:
        put(solving.summary_text(answer, written))
    if out is not None and answer.plan is None:
        say(f"wattlane: there is no plan to write to {out}")
    if trace is not None and not answer.trace:
        say(f"wattlane: {planner} kept no trace to write to {trace}")
    if answer.summary["breaches"]:
        raise typer.Exit(BREACHES)


@app.command()
def bench(
    instances: Annotated[
        Path | None,
        typer.Option("--instances", metavar="DIR", help="Measure the planners on a folder of MovingAI instances."),
    ] = None,
    as_json: JsonOption = False,
    quick: Annotated[bool, typer.Option("--quick", help="Shorter, less exact.")] = False,
) -> None:
    """Measure rates and ratios on this machine, all in one run."""
    from app import bench as benchmarks

    if instances is None:
        results = benchmarks.measure(quick=quick, say=say)
    else:
        from app import bench_instances

        results = bench_instances.measure(instances, quick=quick, say=say)
    if as_json:
        put_json(results)
    else:
        put(benchmarks.table(results))


app.command()(compare)
app.command()(study)


# Ending


def sentence(error: BaseException) -> str:
    """What a person reads for an error."""
    if isinstance(error, OSError):
        if error.errno == errno.ENOSPC:
            return "the disk is full"
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    return str(error)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line and returns the exit code; every foreseen failure is a sentence on stderr."""
    command = typer.main.get_command(app)
    try:
        code = command.main(args=arguments, prog_name="wattlane", standalone_mode=False)
    except typer.Exit as end:
        return int(end.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        say("wattlane: stopped")
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except (WattlaneError, OSError) as error:
        say(f"wattlane: {sentence(error)}")
        return BAD_INPUT
    except _usage_errors() as error:
        context = getattr(error, "ctx", None)
        say(f"wattlane: {error.format_message()} (see `{context.command_path if context else 'wattlane'} --help`)")
        return BAD_INPUT
    return code if isinstance(code, int) else DONE


def _usage_errors() -> Any:
    """The class of errors for unknown options, missing arguments and their like."""
    return next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


if __name__ == "__main__":
    sys.exit(main())
