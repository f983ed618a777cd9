"""Recorded runs and dashboards that the app's tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.settings import Settings
from tests.app.said import Said

SHORT: dict[str, object] = {"time.until_s": 240.0}


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with one finished run of four minutes; tests that change it copy it first."""
    from app import runner
    from engine.results.runs import Catalogue

    data = tmp_path_factory.mktemp("recorded")
    scenario = runner.asked_scenario("soochow2022-continuous", SHORT)
    folder = runner.prepare(Catalogue(data / "runs"), scenario, name="recorded")
    run = runner.Run.new(folder, rerun=False)
    run.advance(10_000)
    run.close()
    return data


@pytest.fixture
def run_id(recorded: Path) -> str:
    return next(folder.name for folder in (recorded / "runs").iterdir())


@pytest.fixture(scope="session")
def client(recorded: Path) -> Iterator[Any]:
    """A client of a dashboard over the recorded run, as a browser on this machine would be."""
    from fastapi.testclient import TestClient

    from app.runs import set_manager
    from app.server import create_app

    app = create_app(Settings(data=recorded, scenario=None, open_browser=False))
    with TestClient(app.server, base_url="http://127.0.0.1:8050") as made:
        yield made
    app.wattlane_manager.close()
    set_manager(None)


@pytest.fixture
def wattlane(capfd: pytest.CaptureFixture[str]) -> Any:
    from app.cli import main

    def call(*arguments: object) -> Said:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return Said(code, out, err)

    return call
