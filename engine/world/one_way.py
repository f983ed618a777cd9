"""One-way rules: the Soochow thesis's rule for nodes, the rule for ways that it needs, and what one-way lanes cost.

The thesis (4.2.4): on a straight road only one of the two directions is allowed at a node, so a node has at most three
actions. Two neighbours that allow only to drive towards each other keep that rule, and meet. What excludes head-on
traffic is a rule for every way between two places: u → v or v → u, never both. A place with a single neighbour can't
keep it, so endpoints stay exceptions, and a reservation of ways is needed there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.world.motion_graph import MotionGraph


def _ways(graph: MotionGraph) -> NDArray[np.int64]:
    """(n, 2) ordered pairs of different places between which a motion leads, each once."""
    pairs = np.stack([graph.state_place[graph.edge_from], graph.state_place[graph.edge_to]], 1).astype(np.int64)
    return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)


def both_ways(graph: MotionGraph) -> list[tuple[int, int]]:
    """Pairs of places (a < b) between which vehicles drive in both directions: there a swap is possible."""
    ways = set(map(tuple, _ways(graph).tolist()))
    return sorted((a, b) for a, b in ways if a < b and (b, a) in ways)


def breaks_node_rule(graph: MotionGraph) -> list[int]:
    """Places that may be left straight ahead and straight back: those that the thesis's rule forbids."""
    xy, out = graph.xy_m, []
    leaves: dict[int, list[int]] = {}
    for a, b in _ways(graph).tolist():
        leaves.setdefault(a, []).append(b)
    for a, neighbours in leaves.items():
        away = [xy[b] - xy[a] for b in neighbours]
        if any(np.allclose(u, -v) for i, u in enumerate(away) for v in away[:i]):
            out.append(a)
    return out


def strongly_connected(graph: MotionGraph) -> bool:
    """True when every place can be reached from every other."""
    from scipy.sparse import csgraph

    return int(csgraph.connected_components(_matrix(graph), connection="strong", return_labels=False)) == 1


def steps_between(graph: MotionGraph, places: NDArray[np.int32]) -> NDArray[np.float64]:
    """(n, n) fewest steps from each place to each other, infinite where no way leads; a diagonal counts as one."""
    from scipy.sparse import csgraph

    found = csgraph.dijkstra(_matrix(graph), indices=places, unweighted=True)
    steps: NDArray[np.float64] = found[:, places]
    return steps


def _matrix(graph: MotionGraph) -> Any:
    from scipy.sparse import coo_matrix

    ways, n = _ways(graph), graph.n_places
    return coo_matrix((np.ones(len(ways)), (ways[:, 0], ways[:, 1])), (n, n)).tocsr()
