"""The front door lists what exists, in the order in which data flows."""

import subprocess
import sys

import engine
from engine.build import build


def test_every_listed_name_is_there():
    for name in engine.__all__:
        assert getattr(engine, name).__name__.lstrip("_") == name


def test_the_docstring_example_runs():
    log = engine.MemoryLog()
    sim = build("soochow2022", seed=1, recorder=log)
    sim.advance(3600)
    sim.flush()
    assert sim.done
    assert engine.judge(log, sim.scenario, sim.world) == []


def test_looking_in_loads_nothing_heavy():
    code = "import sys, engine; print(sorted({'numba', 'scipy', 'pyarrow', 'numpy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
