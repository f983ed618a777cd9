"""Numbers with a home and a source. Every set says what was printed, reconstructed or assumed."""

from __future__ import annotations


def xu2025(speed_mps: float = 1.0) -> dict[str, float]:
    """Xu & Wang 2025; the paper's table 1 is lost, so these are a calibration to its results.

    mu, standby_w, length_m, width_m, omega: chosen so that a turn costs 2.6 straight cells at 1000 kg, which fits the
    paper's 12–16 % savings; gravity: physics. Inertia is m(length²+width²)/12.
    """
    return {
        "mu": 0.01,
        "g": 9.81,
        "v_mps": speed_mps,
        "standby_w": 30.0,
        "omega": 1.5707963267948966,
        "length_m": 1.2,
        "width_m": 0.9,
    }


def constant() -> dict[str, float]:
    """Soochow thesis 2022: −1 % of the battery per second while running (printed), nothing while standing."""
    return {"percent_per_s": 1.0}
