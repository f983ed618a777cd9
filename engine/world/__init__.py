"""Where vehicles move: floors, their motion graphs and what stands on them."""

from engine.world.floor import FloorPlan, Station, World, build_world
from engine.world.grid import GridMotion
from engine.world.motion_graph import MotionGraph, Primitive

__all__ = ["FloorPlan", "GridMotion", "MotionGraph", "Primitive", "Station", "World", "build_world"]
