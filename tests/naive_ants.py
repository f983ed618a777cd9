"""The ant colony again, slow and obvious: NumPy arrays, Python loops, no compiled code.

`python -m tests.naive_ants` measures how much faster the compiled colony is (CPU time of one process).
"""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np

MASK = 2**64 - 1


class SplitMix:
    """splitmix64, as numbers in [0, 1)."""

    def __init__(self, seed: int) -> None:
        self.state = seed & MASK

    def draw(self) -> float:
        self.state = x = (self.state + 0x9E3779B97F4A7C15) & MASK
        x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & MASK
        return ((x ^ (x >> 31)) >> 11) * 2.0**-53


def probabilities(tau: Any, eta: Any, alpha: float, beta: float, factor: float = 1.0) -> Any:
    """p_ij of the thesis for the steps that an ant may take."""
    weights = tau**alpha * (factor * eta) ** beta
    return weights / weights.sum()


def ant(
    step: Any, closed: Any, weight: Any, start: int, goal: int, aco: Any, random: SplitMix
) -> list[tuple[int, int]]:
    """(place, direction) of every step of one ant; empty when it is lost."""
    none, explore = len(step) - 1, aco.explore if aco.rule == "improved" else 1.0
    seen, trail, at = {start}, [], start
    while at != goal:
        open_ = [d for d, j in enumerate(step[at]) if j != none and j not in seen and not closed[j]]
        if not open_:
            if not aco.retreat or not trail:
                return []
            at = trail.pop()[0]
            continue
        w = weight[at, open_]
        if random.draw() >= explore:
            chosen = open_[int(np.argmax(w >= w.max() * (1 - 1e-12)))]
        else:
            bar, running = random.draw() * np.cumsum(w)[-1], np.cumsum(w)
            beyond = np.flatnonzero(running > bar)
            chosen = open_[int(beyond[0]) if len(beyond) else -1]
        trail.append((at, chosen))
        at = int(step[at, chosen])
        seen.add(at)
    return trail


def better_than_median(lengths: list[int]) -> list[int]:
    """Which of the ants that arrived lay pheromone: those below the median; the first of the shortest if none is."""
    chosen = [a for a, n in enumerate(lengths) if n < np.median(lengths)]
    return chosen or ([int(np.argmin(lengths))] if lengths else [])


def colony(floor: Any, aco: Any, start: int, goal: int, seed: int) -> tuple[list[int], Any, list[int]]:
    """(places of the best way, pheromone at the end, best length by iteration)."""
    step, closed, eta = floor.grounds.step, floor.blocked, aco.eta(floor, goal)
    places, ways = len(step) - 1, step.shape[1]
    leads = (step[:-1] != places) & ~np.append(closed, 1).astype(bool)[step[:-1]]
    eta_to = np.where(leads, np.append(eta, 0)[step[:-1]], 0.0)
    tau = np.full((places, ways), float(aco.tau0))
    random, best, history = SplitMix(seed), None, []
    for k in range(aco.iterations):
        induced = (1 - aco.xi) / aco.xi * (aco.iterations - k) / aco.iterations
        kind = aco.inducement if aco.rule == "improved" else "off"
        power, factor = (
            (aco.beta * induced if kind == "exponent" else aco.beta),
            (induced if kind == "literal" else 1.0),
        )
        # scalar powers: NumPy's own over arrays may differ in the last bit
        weight = np.array(
            [
                float(t) ** float(aco.alpha) * (factor * float(e)) ** power if ok else 0.0
                for t, e, ok in zip(tau.ravel(), eta_to.ravel(), leads.ravel(), strict=True)
            ]
        ).reshape(tau.shape)
        trails = [ant(step, closed, weight, start, goal, aco, random) for _ in range(aco.ants)]
        home = [trail for trail in trails if trail]
        for trail in home:
            if best is None or len(trail) < len(best):
                best = trail
        tau *= 1 - aco.rho
        if aco.rule == "improved":
            layers = [home[a] for a in better_than_median([len(trail) for trail in home])]
        else:
            layers = [best] if best else []
        for trail in layers:
            for at, d in trail:
                tau[at, d] += aco.rho * aco.q / (len(layers) * len(trail))
        tau = np.clip(tau, aco.low, aco.high)
        history.append(len(best) if best else -1)
    way = [at for at, _ in best] + [goal] if best else []
    return way, tau, history


def main() -> None:
    """Prints CPU times of both on the same floors."""
    from engine.planners.aco import Aco
    from engine.planners.single import Floor
    from engine.scenario.floor_costs import xu2025_costs
    from engine.scenario.movingai import single_instance

    slow_s = fast_s = 0.0
    for number in range(4):
        instance = single_instance(np.random.default_rng(number), 20, 0.2)
        graph = instance.graph()
        floor = Floor(graph, xu2025_costs(graph, (1000.0,), {}))
        start, goal = instance.place(instance.starts[0]), instance.place(instance.goals[0])
        aco = replace(Aco(), ants=30, iterations=40)
        aco.search(floor, start, goal, number)
        begun = process_time()
        for _ in range(20):
            found = aco.search(floor, start, goal, number)
        fast_s += (process_time() - begun) / 20
        begun = process_time()
        way, _, _ = colony(floor, aco, start, goal, number)
        slow_s += process_time() - begun
        assert way == found.places.tolist()
    print(
        f"NumPy {slow_s / 4 * 1e3:.1f} ms, compiled {fast_s / 4 * 1e3:.2f} ms per colony: {slow_s / fast_s:.0f} times"
    )


if __name__ == "__main__":
    main()
