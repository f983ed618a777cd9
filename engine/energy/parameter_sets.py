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


def drive(speed_mps: float = 1.0) -> dict[str, float]:
    """Lian et al. 2024: the motor's R, L and C_e are printed, everything else is assumed.

    With 500 kg and a gear of 30, motors take 84 % of the power at cruising speed; the paper says more than 80 %. Size,
    track and ramps are such that a pivot of 90 degrees in the printed second stays below the motor's stall current.
    """
    return {
        "v_mps": speed_mps,
        "wheel_m": 0.1,
        "track_m": 0.6,
        "gear": 30.0,
        "gear_efficiency": 0.85,
        "r_ohm": 0.4898,
        "l_h": 0.0044,
        "ce_vs": 0.0327,
        "mu": 0.015,
        "g": 9.81,
        "accel_mps2": 0.5,
        "regen": 0.0,
        "length_m": 0.6,
        "width_m": 0.6,
        "standby_w": 20.0,
    }


def drive_paper(speed_mps: float = 1.0) -> dict[str, float]:
    """Lian et al. 2024, equations 6–8; printed: 1 for the printed factor and radius, 0 for the corrected ones."""
    return {"v_mps": speed_mps, "wheel_m": 0.1, "printed": 0.0, "standby_w": 20.0}


def constant() -> dict[str, float]:
    """Soochow thesis 2022: −1 % of the battery per second while running (printed), nothing while standing."""
    return {"percent_per_s": 1.0}
