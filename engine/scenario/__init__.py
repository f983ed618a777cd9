"""What was asked: scenarios as strict TOML, the built-in library, and checks on load."""

from engine.scenario.instances import from_movingai, goal_places
from engine.scenario.model import Scenario
from engine.scenario.parameters import parameters
from engine.scenario.reading import from_dict, library, load, parse
from engine.scenario.start import start_places

__all__ = [
    "Scenario",
    "from_dict",
    "from_movingai",
    "goal_places",
    "library",
    "load",
    "parameters",
    "parse",
    "start_places",
]
