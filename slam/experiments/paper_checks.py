"""Consistency checks of the paper's numbers: each one against the value that others imply."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, radians, sqrt, tan

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from backend.measurements import GRAVITY_M_S2
from slam.evaluation.paper_values import (
    DIAGONAL_M,
    FEATURE_DISTANCE_PX,
    FIELD_OF_VIEW_DEG,
    FLOOR_AT_1M_M,
    HOVER_DRIFT_M,
    HOVER_DRIFT_VARIANCE,
    HOVER_SPEED_M_S,
    HOVER_SPEED_VARIANCE,
    OVERLAP_SPEED_M_S,
    P_THETA,
    PITCH_DEG,
    SIDE_M,
    SPEED_A_DEGREE,
    SPEED_M_S,
    SQUARE_DRONE_M,
    SQUARE_M,
    SQUARE_PERCENT,
    STICKS,
    TOP_SPEED_M_S,
    TOP_SPEED_PERCENT,
    WHITE_BALANCE_M,
    WHITE_BALANCE_PERCENT,
)

Array = NDArray[np.float64]

TUM_DRAG_1_S, TUM_TILT_SCALE_M_S = 0.58, 17.8
"""Constants c1 and c2 of the tum_ardrone package for the same drone: a second, independent measurement."""
HOVER_S, HOVER_CORRELATION_S = 35.0, 0.5
WIDTH_PX, HEIGHT_PX = 176, 144
OUTLIER = 0.10
"""The stick of table 5 whose speed lies off the line of the others."""


@dataclass(frozen=True)
class Check:
    """One number of the paper and the value that the paper's other numbers imply."""

    name: str
    unit: str
    paper: float
    recomputed: float
    tolerance: float
    """Relative tolerance for rounding; within it the two agree."""
    explanation: str

    @property
    def holds(self) -> bool:
        """Whether the paper's number follows from its others."""
        return abs(self.recomputed - self.paper) <= self.tolerance * abs(self.paper)


def checks() -> tuple[Check, ...]:
    """Return all checks."""
    return (*_tables(), *_motion(), *_hover(), *_camera())


def _tables() -> tuple[Check, ...]:
    worst = max(WHITE_BALANCE_M.values())
    drone, filtered = (FEATURE_DISTANCE_PX[key] / FEATURE_DISTANCE_PX["without"] for key in ("drone", "with"))
    return (
        Check(
            "table 2, D-A", "%", WHITE_BALANCE_PERCENT["D-A"], 100 * worst / SIDE_M, 0.01,
            f"the sides of table 2 were divided by {100 * worst / WHITE_BALANCE_PERCENT['D-A']:.2f} m "
            f"instead of {SIDE_M} m. The largest is {100 * worst / SIDE_M:.1f} %",
        ),
        Check(
            "table 2, B-D", "%",
            WHITE_BALANCE_PERCENT["B-D"], 100 * WHITE_BALANCE_M["B-D"] / DIAGONAL_M, 0.01,
            "the diagonal is right",
        ),
        Check(
            "table 1, simulated B-D", "%", SQUARE_PERCENT["B-D"], 100 * SQUARE_M["B-D"] / DIAGONAL_M, 0.01,
            f"it was divided by {100 * SQUARE_M['B-D'] / SQUARE_PERCENT['B-D']:.2f} m, a side, instead of "
            "the diagonal",
        ),
        Check(
            "table 1, simulated D-A", "%", SQUARE_PERCENT["D-A"], 100 * SQUARE_M["D-A"] / SIDE_M, 0.01,
            "the largest error of table 1 is right",
        ),
        Check(
            "feature distance, with over without", "1", drone, filtered, 0.01,
            "simulated and real drone agree in the mean; blur, yaw or distortion could give the same mean",
        ),
    )  # fmt: skip


def line_through_table_5(leave_out: float | None = None) -> float:
    """Slope in m/s a degree of the least-squares line of table 5 through the origin."""
    pitch, speed = (np.array([of[s] for s in STICKS if s != leave_out]) for of in (PITCH_DEG, SPEED_M_S))
    return float(pitch @ speed / (pitch @ pitch))


def drag_1_s(leave_out: float | None = None) -> float:
    """Drag k of g tan(theta) = k v, in 1/s, by least squares over the steady points."""
    force, speed = _steady(leave_out)
    return float(force @ speed / (speed @ speed))


def misfit_m_s2(power: int) -> float:
    """Residual standard deviation of g tan(theta) = c v^power without s = 0.10, 3 degrees of freedom."""
    force, speed = _steady(OUTLIER)
    drag = speed**power
    residual = force - force @ drag / (drag @ drag) * drag
    return float(np.sqrt(residual @ residual / (len(residual) - 1)))


def odd_point() -> tuple[float, float, float]:
    """Compare the speed at s = 0.10 with the line through the other sticks.

    Returns the speed on that line, and the t value of the drone's own speed with its two-sided p (3 degrees
    of freedom). The stick is exact, but the measured pitch is not; the pitch was proportional to it, as it
    should be.
    """
    others = [s for s in STICKS if s != OUTLIER]
    stick, speed = np.array(others), np.array([SPEED_M_S[s] for s in others])
    slope = stick @ speed / (stick @ stick)
    residual = speed - slope * stick
    variance = residual @ residual / (len(others) - 1)
    std = sqrt(variance * (1 + OUTLIER**2 / (stick @ stick)))
    t = float((SPEED_M_S[OUTLIER] - slope * OUTLIER) / std)
    return float(slope * OUTLIER), t, float(2 * student.sf(abs(t), len(others) - 1))


def free_drift_m(correlation_s: float) -> tuple[float, float]:
    """Mean distance of free motion with the paper's variance an axis: over ``HOVER_S``, and at the end.

    The speed is an Ornstein-Uhlenbeck process.
    """
    times = np.linspace(0, HOVER_S, 2001)
    tau = correlation_s
    variance = 2 * HOVER_SPEED_VARIANCE * tau * (times - tau * (1 - np.exp(-times / tau)))
    distance = np.sqrt(variance * pi / 2)
    return float(np.mean(distance)), float(distance[-1])


def _steady(leave_out: float | None = None) -> tuple[Array, Array]:
    kept = [s for s in STICKS if s != leave_out]
    force = GRAVITY_M_S2 * np.tan(np.radians([PITCH_DEG[s] for s in kept]))
    return force, np.array([SPEED_M_S[s] for s in kept])


def _motion() -> tuple[Check, ...]:
    expected, t, p = odd_point()
    return (
        Check(
            "c of equation 4, least squares through table 5",
            "m/s/deg", SPEED_A_DEGREE, line_through_table_5(), 0.01,
            f"{SPEED_A_DEGREE} is v / theta of s = 0.25 alone, {SPEED_M_S[0.25] / PITCH_DEG[0.25]:.4f}, "
            "not the fit that the text names",
        ),
        Check(
            "c of equation 4, from P_theta", "m/s/deg", SPEED_A_DEGREE, radians(1) / P_THETA, 0.01,
            "P_theta and equation 4 differ by 3 %",
        ),
        Check(
            "drag of table 5, beside g P_theta", "1/s", GRAVITY_M_S2 * P_THETA, drag_1_s(), 0.02,
            f"drag linear in the speed holds: {drag_1_s():.3f}, {drag_1_s(OUTLIER):.3f} without s = 0.10; a "
            f"drag quadratic in the speed misses by {misfit_m_s2(2) / misfit_m_s2(1):.1f} times as much",
        ),
        Check(
            "P_theta, beside 1 / c2 of tum_ardrone", "rad/(m/s)", P_THETA, 1 / TUM_TILT_SCALE_M_S, 0.02,
            "others found the same for this drone",
        ),
        Check(
            "drag g P_theta, beside c1 of tum_ardrone", "1/s", GRAVITY_M_S2 * P_THETA, TUM_DRAG_1_S, 0.05,
            "and the same drag",
        ),
        Check(
            "speed at s = 0.10, from the other four", "m/s", SPEED_M_S[OUTLIER], expected, 0.10,
            f"{100 * (SPEED_M_S[OUTLIER] / expected - 1):.0f} % off the line, t = {t:.1f}, p = {p:.2f} and "
            f"{1 - (1 - p) ** 5:.2f} for the worst of five. This is suspicious, not certain. A pulse of 5 s "
            "at s = 0.10 should be repeated",
        ),
    )  # fmt: skip


def _hover() -> tuple[Check, ...]:
    rayleigh, still = HOVER_SPEED_M_S**2 * 2 / pi, HOVER_DRIFT_M**2 * 2 / pi
    tilt = radians(PITCH_DEG[0.25])
    drift, at_end = free_drift_m(HOVER_CORRELATION_S)
    largest = max(SQUARE_DRONE_M.values())
    return (
        Check(
            "variance of the hover's speed, one axis", "m²/s²", HOVER_SPEED_VARIANCE, rayleigh, 0.10,
            f"so 0.0012 is of one axis: of the speed itself it would be {(2 - pi / 2) * rayleigh:.5f}",
        ),
        Check(
            "variance of the hover's distance", "m²", HOVER_DRIFT_VARIANCE, (2 - pi / 2) * still, 0.20,
            "here 0.0012 is of the distance itself, unlike that of the speed",
        ),
        Check(
            "mean distance of a hover that nothing holds", "m", HOVER_DRIFT_M, drift, 0.10,
            f"with a correlation of {HOVER_CORRELATION_S} s it would be {drift:.2f} m on average and "
            f"{at_end:.2f} m at the end. A distance of {HOVER_DRIFT_M} m needs {_needed_correlation_s():.2f} "
            "s. The position is controlled, or most of the variance is noise of the log",
        ),
        Check(
            "largest scale error of a sonar by tilt",
            "%", 100 * largest / SIDE_M, 100 * (1 / cos(tilt) - 1), 0.10,
            f"tilt explains {100 * (1 / cos(tilt) - 1):.2f} % of the {100 * largest / SIDE_M:.0f} % of "
            "table 1. Another cause is needed",
        ),
    )  # fmt: skip


def _needed_correlation_s() -> float:
    grid = np.geomspace(0.005, 1.0, 400)
    return float(grid[np.argmin([abs(free_drift_m(tau)[0] - HOVER_DRIFT_M) for tau in grid])])


def _camera() -> tuple[Check, ...]:
    half = radians(FIELD_OF_VIEW_DEG / 2)
    floor = 2 * tan(half)
    across, diagonal = WIDTH_PX / 2 / tan(half), np.hypot(WIDTH_PX, HEIGHT_PX) / 2 / tan(half)
    fast, slow = OVERLAP_SPEED_M_S[15.0], OVERLAP_SPEED_M_S[6.67]
    return (
        Check(
            "floor seen from 1 m", "m", FLOOR_AT_1M_M, floor, 0.01,
            f"the 64 degrees are across the picture: f = {across:.1f} px; across the diagonal it would be "
            f"{diagonal:.1f} px, {100 * (diagonal / across - 1):.0f} % more",
        ),
        Check(
            "speed at half overlap and 15 Hz", "m/s", fast, 0.5 * floor * 15, 0.01,
            "right for flight sideways",
        ),
        Check(
            "speed at half overlap and 6.67 Hz", "m/s", slow, 0.5 * floor * 6.67, 0.01,
            "right for flight sideways",
        ),
        Check(
            "that speed as a share of the top speed", "%",
            TOP_SPEED_PERCENT, 100 * slow / TOP_SPEED_M_S, 0.01, "right",
        ),
    )  # fmt: skip
