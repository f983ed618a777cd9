"""Numbers with a home and a source. Every set says what was printed, reconstructed or assumed."""

from __future__ import annotations

CELL_NOMINAL_V = 3.7
"""Nominal voltage of a lithium cell: 25.9 V are seven in series."""


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


def lian2024(speed_mps: float = 1.0) -> dict[str, float]:
    """Lian et al. 2024, drive and motors.

    Printed: resistance_ohm, inductance_h, emf_vs. All others are lost or never given, so assumed: mu, hard polyurethane
    on concrete (0.01-0.02); wheel_m, gear, gear_efficiency and standby_w so that a vehicle of 500 kg, the mass assumed
    for it, gives its motors the "more than 80 %" of the paper (84 % while cruising; with 100 kg and gear 20 they take
    half); length_m, width_m, track_m, a body whose 500 kg these motors still turn by 90 degrees in the printed 1000 ms
    on 25.9 V (0.6 x 0.5 m would need 29 V); accel_mps2, brake_mps2, usual for such vehicles and below 20 V. recovery
    0: the paper speaks of none.
    """
    return {
        "mu": 0.015,
        "g": 9.81,
        "v_mps": speed_mps,
        "standby_w": 20.0,
        "wheel_m": 0.1,
        "track_m": 0.5,
        "gear": 30.0,
        "gear_efficiency": 0.85,
        "length_m": 0.5,
        "width_m": 0.5,
        "resistance_ohm": 0.4898,
        "inductance_h": 0.0044,
        "emf_vs": 0.0327,
        "accel_mps2": 0.5,
        "brake_mps2": 0.5,
        "recovery": 0.0,
    }


def zhang2021(speed_mps: float = 0.5) -> dict[str, float]:
    """Zhang et al. 2021, a skid-steered robot on four wheels; its tables 1 and 2 are lost, so all of it is assumed.

    A Husky-like robot of 60 kg: wheel_m, track_m, wheelbase_m; motors torque_nm_a (K_T), gear, resistance_ohm (R_e) and
    efficiency (of motor and gear); mu, rolling off the road; mu_turn, wheels dragged sideways. track_factor: a
    skid-steered robot turns as if its track were 1.5 to 2 times as wide. scrub_m: wheels that are dragged along a curve
    of this radius meet 63 % of the resistance of a turn on the spot. speed_mps: the paper's [0, 0.5] m/s. standby_w:
    computer and laser scanner. recovery 0: the paper's motors "store energy" when driven, how much it does not say.
    printed_efficiency: 1 multiplies by the efficiency as (6) and (7) print it, 0 divides.
    """
    return {
        "mu": 0.08,
        "g": 9.81,
        "v_mps": speed_mps,
        "standby_w": 40.0,
        "wheel_m": 0.165,
        "track_m": 0.55,
        "track_factor": 1.5,
        "wheelbase_m": 0.51,
        "torque_nm_a": 0.044,
        "gear": 78.0,
        "resistance_ohm": 0.45,
        "efficiency": 0.8,
        "mu_turn": 0.5,
        "scrub_m": 1.0,
        "recovery": 0.0,
        "printed_efficiency": 0.0,
    }


def tremblay() -> dict[str, float]:
    """The lithium cell of Lian et al. 2024.

    Printed: rated_ah; 8 A over 50 minutes, which makes delivered_ah (111 % of rated), and the zone of 2.5 to 49
    minutes, stable_from_ah to stable_to_ah. Fitted to assumed voltages (4.05 V full, 3.85 at 2.5, 3.36 at 49 and
    2.75 at 50 minutes, rms 34 mV): e0_v, k, a_v, b_per_ah, r_ohm, q_ah. Assumed: lag_s; charging with half the rated
    current to 4.1 V, a bit above what these constants give a full cell (E0 + A = 4.096 V; the usual 4.2 V would never
    be reached), down to a twentieth.
    """
    return {
        "e0_v": 3.7022,
        "k": 5.4e-4,
        "a_v": 0.3935,
        "b_per_ah": 1.0,
        "r_ohm": 0.01213,
        "q_ah": 6.729,
        "rated_ah": 6.0,
        "delivered_ah": 8.0 * 50 / 60,
        "lag_s": 30.0,
        "stable_from_ah": 8.0 * 2.5 / 60,
        "stable_to_ah": 8.0 * 49 / 60,
        "charge_a": 3.0,
        "charge_v": 4.1,
        "stop_a": 0.3,
    }
