"""Where vehicles move: floors, their motion graphs and what stands on them."""

from engine.world.floor import FloorPlan, GridWorld, Station, World, build_world
from engine.world.grid import GridMotion
from engine.world.motion_graph import MotionGraph, Primitive
from engine.world.network import NetworkPlan, NetworkWorld

__all__ = [
    "FloorPlan",
    "GridMotion",
    "GridWorld",
    "MotionGraph",
    "NetworkPlan",
    "NetworkWorld",
    "Primitive",
    "Station",
    "World",
    "build_world",
]
