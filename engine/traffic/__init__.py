"""Traffic: reservations by interval, plans under execution, the shared route timer."""

from engine.traffic.arc_times import ArcTimes, new_arc_times, observe
from engine.traffic.claims import Claims, claim, gap_at, gap_end, grown, new_claims, release
from engine.traffic.departures import DETOUR, HORIZON, STAY, GraphArrays, Ground, departure, graph_arrays, ground_of
from engine.traffic.steps import FAR, Steps, commit, forget, held, lift, new_steps, put_back, retime, wider

__all__ = [
    "DETOUR",
    "FAR",
    "HORIZON",
    "STAY",
    "ArcTimes",
    "Claims",
    "GraphArrays",
    "Ground",
    "Steps",
    "claim",
    "commit",
    "departure",
    "forget",
    "gap_at",
    "gap_end",
    "graph_arrays",
    "ground_of",
    "grown",
    "held",
    "lift",
    "new_arc_times",
    "new_claims",
    "new_steps",
    "observe",
    "put_back",
    "release",
    "retime",
    "wider",
]
