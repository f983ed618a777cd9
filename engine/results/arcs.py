"""What driving along single arcs took in a run, and whether it is distributed as a paper says: from the log alone.

Descriptives as SPSS prints them (Lian et al. 2024, table 1): skewness and kurtosis are the bias-corrected G1 and G2
with their standard errors under normality. Normality (table 2): Lilliefors' test, which is Kolmogorov–Smirnov with
fitted mean and deviation and so with its own distribution, by Monte Carlo; and Shapiro–Wilk. Not rejecting normality is
no proof of it: with few samples hardly anything is rejected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.results.runlog import Log
from engine.results.schema import MOTION
from engine.traffic import new_arc_times, observe
from engine.world.floor import World

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

LEAST = 8
"""Fewer samples are not tested."""
MC_ROUNDS = 2000
MAX_TESTED = 5000
"""Shapiro–Wilk's p-value is known up to so many samples."""


@dataclass(frozen=True, slots=True)
class Visits:
    """Finished visits of arcs in the order of their ends: place (a lane), tick of the end, duration in ms."""

    place: I64
    tick: I64
    ms: F64

    def of(self, place: int) -> F64:
        """Durations at one arc."""
        found: F64 = self.ms[self.place == place]
        return found


def visits(log: Log, world: World, tick_s: float, first: int = 0, last: int | None = None) -> Visits:
    """Visits that ended in [first, last) ticks."""
    rows = motion_rows(log)
    fleet = int(rows[:, 0].max(initial=-1)) + 1
    times = new_arc_times(world.graph.arc_ticks, fleet)
    place, ticks = np.empty(len(rows), np.int32), np.empty(len(rows), np.int32)
    ended = np.empty(len(rows), np.int32)
    n = observe(times, rows, len(rows), place, ticks, ended)
    place, ticks, ended = place[:n], ticks[:n], ended[:n]
    order = np.argsort(ended, kind="stable")
    place, ticks, ended = place[order], ticks[order], ended[order]
    kept = (ended >= first) & (ended < (last if last is not None else np.iinfo(np.int32).max))
    return Visits(
        place[kept].astype(np.int64), ended[kept].astype(np.int64), ticks[kept].astype(np.float64) * tick_s * 1000
    )


def motion_rows(log: Log) -> I64:
    """The motion table as one integer array, by vehicle and time."""
    m = log.table("motions")
    rows = np.stack([np.asarray(m[c], np.int64) for c in MOTION], axis=1)
    return rows[np.lexsort((rows[:, 4], rows[:, 0]))]


def busy_s(log: Log, world: World, tick_s: float, first: int, last: int) -> F64:
    """Seconds of [first, last) during which each place was held, (P,): table 3 of the paper for its arcs."""
    rows = motion_rows(log)
    out = np.zeros(world.n_places)
    here, there = rows[:, 6], rows[:, 7]
    span = np.maximum(np.minimum(rows[:, 5], last) - np.maximum(rows[:, 4], first), 0) * tick_s
    np.add.at(out, there, span)
    moves = here != there
    np.add.at(out, here[moves], span[moves])
    return out


def describe(ms: F64) -> dict[str, float]:
    """Descriptives of samples as in the paper's table 1, with standard errors of mean, skewness and kurtosis."""
    from scipy import stats

    n = len(ms)
    sd = float(np.std(ms, ddof=1)) if n > 1 else 0.0
    mean, se = float(np.mean(ms)), sd / n**0.5
    half = float(stats.t.ppf(0.975, n - 1)) * se if n > 1 else 0.0
    low, high = np.percentile(ms, [25, 75], method="weibull")  # SPSS's definition
    varies = sd > 0 and n > 3
    return {
        "n": n,
        "mean": mean,
        "se": se,
        "ci_low": mean - half,
        "ci_high": mean + half,
        "trimmed_mean": float(stats.trim_mean(ms, 0.05)),
        "median": float(np.median(ms)),
        "sd": sd,
        "max": float(np.max(ms)),
        "min": float(np.min(ms)),
        "range": float(np.ptp(ms)),
        "iqr": float(high - low),
        "skew": float(stats.skew(ms, bias=False)) if varies else 0.0,
        "skew_se": skew_se(n),
        "kurtosis": float(stats.kurtosis(ms, bias=False)) if varies else 0.0,
        "kurtosis_se": kurtosis_se(n),
    }


def skew_se(n: int) -> float:
    """Standard error of the skewness of n normal samples: 0.512 for 20."""
    return float((6 * n * (n - 1) / ((n - 2) * (n + 1) * (n + 3))) ** 0.5) if n > 2 else float("nan")


def kurtosis_se(n: int) -> float:
    """Standard error of the excess kurtosis of n normal samples: 0.992 for 20."""
    return float(2 * skew_se(n) * ((n * n - 1) / ((n - 3) * (n + 5))) ** 0.5) if n > 3 else float("nan")


def normality(ms: F64, rng: np.random.Generator | None = None) -> dict[str, float]:
    """Lilliefors' D and Shapiro–Wilk's W with their p-values; p = 0 when all samples are equal. Needs LEAST samples."""
    from scipy import stats

    n = len(ms)
    if n < LEAST:
        raise ValueError(f"got {n} samples, expected at least {LEAST}")
    if np.ptp(ms) == 0:
        return {"n": n, "lilliefors_d": 1.0, "lilliefors_p": 0.0, "shapiro_w": 0.0, "shapiro_p": 0.0}
    shapiro = stats.shapiro(ms[:MAX_TESTED])
    lilliefors = stats.goodness_of_fit(
        stats.norm, ms, statistic="ks", n_mc_samples=MC_ROUNDS, rng=rng or np.random.default_rng(0)
    )
    return {
        "n": n,
        "lilliefors_d": float(lilliefors.statistic),
        "lilliefors_p": float(lilliefors.pvalue),
        "shapiro_w": float(shapiro.statistic),
        "shapiro_p": float(shapiro.pvalue),
    }


def shares_that_pass(found: Visits, level: float = 0.05, least: int = 20, most: int = 200) -> Mapping[str, Any]:
    """Of the arcs with at least `least` visits, the share that each test does not reject as normal, and the skewness.

    Of every arc the first `most` visits are taken. The paper tests one arc with 20 samples and says that all others
    pass too.
    """
    rng = np.random.default_rng(0)
    places, counts = np.unique(found.place, return_counts=True)
    some = places[counts >= least]
    rows = [(normality(ms, rng), describe(ms)["skew"]) for ms in (found.of(int(p))[:most] for p in some)]
    passed = {
        test: sum(row[f"{test}_p"] > level for row, _ in rows) / len(rows) if rows else 0.0
        for test in ("lilliefors", "shapiro")
    }
    return {
        "arcs": len(rows),
        "level": level,
        **passed,
        "median_skew": float(np.median([skew for _, skew in rows])) if rows else 0.0,
    }
