"""The flown motion: a planned path, held the way a small quadrotor holds it.

A vehicle in still air accelerates by tilting and is slowed by drag linear in its speed; so the path decides
the tilt. On top of the path lies what makes a hover look like one: the tilt jitters, the jitter
accelerates the vehicle, and its position hold brings it back. All is one smooth function of time, so that
whatever an instrument reads is consistent with whatever another reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.spatial.transform import Rotation

from slam.simulation.maneuver import Path

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.80665
KNOT_S = 0.02
"""Spacing of the drawn hold noise, a fifth of the vehicle's own lag."""
ATTITUDE_LAG_S = 0.10
"""Time constant with which the attitude follows its target."""
HOLD_DAMPING = 0.7


@dataclass(frozen=True)
class Vehicle:
    """Drag and restlessness of the vehicle.

    Source of the drag: IMAV 2011 paper, P_theta = 0.057 and k = g P_theta.
    """

    drag_1_s: Annotated[float, Field(ge=0, le=10)] = 0.559
    tilt_std_deg: Annotated[float, Field(ge=0, le=5)] = 0.4
    """Jitter of roll and pitch about what the path asks for."""
    tilt_correlation_s: Annotated[float, Field(ge=0.05, le=5)] = 0.25
    altitude_std_m: Annotated[float, Field(ge=0, le=1)] = 0.012
    heading_std_deg: Annotated[float, Field(ge=0, le=20)] = 0.5
    hold_rad_s: Annotated[float, Field(ge=0.1, le=10)] = 1.2
    """Natural frequency with which position, height and heading are held."""


@dataclass(frozen=True)
class State:
    """The vehicle at n moments."""

    stamps_s: Array
    w_p_m: Array
    """(n, 3)."""
    w_v_m_s: Array
    w_a_m_s2: Array
    roll_pitch_yaw_rad: Array
    """(n, 3): R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    b_rate_rad_s: Array
    """(n, 3) angular velocity in body axes: what a gyro reads."""

    @property
    def w_R_b(self) -> Array:
        """(n, 3, 3)."""
        return Rotation.from_euler("ZYX", self.roll_pitch_yaw_rad[:, ::-1]).as_matrix().reshape(-1, 3, 3)

    @property
    def w_T_b(self) -> Array:
        """(n, 4, 4)."""
        pose = np.tile(np.eye(4), (len(self.stamps_s), 1, 1))
        pose[:, :3, :3] = self.w_R_b
        pose[:, :3, 3] = self.w_p_m
        return pose

    @property
    def b_specific_force_m_s2(self) -> Array:
        """(n, 3) R_wb^T (a + (0, 0, g)): what an accelerometer reads."""
        return np.einsum("nij,ni->nj", self.w_R_b, self.w_a_m_s2 + [0.0, 0.0, GRAVITY_M_S2])


@dataclass(frozen=True)
class Motion:
    """The flown motion as a function of time."""

    path: Path
    wander: tuple[BSpline, BSpline, BSpline, BSpline]
    """(x, y, z, yaw) off the path, and its derivatives."""
    drag_1_s: float

    @property
    def duration_s(self) -> float:
        """The motion is known from 0 to here."""
        return self.path.duration_s

    def at(self, stamps_s: Array) -> State:
        """The state at any times within the flight. (n,)."""
        t = np.asarray(stamps_s, dtype=float)
        q, dq, ddq, dddq = (p(t) + w(t) for p, w in zip(self.path.derivatives, self.wander, strict=True))
        slope = (ddq[:, :2] + self.drag_1_s * dq[:, :2]) / GRAVITY_M_S2
        slope_rate = (dddq[:, :2] + self.drag_1_s * ddq[:, :2]) / GRAVITY_M_S2
        angles, rates = _tilt(slope, slope_rate, q[:, 3], dq[:, 3])
        return State(t, q[:, :3], dq[:, :3], ddq[:, :3], angles, rates)


def fly(path: Path, vehicle: Vehicle, rng: np.random.Generator) -> Motion:
    """Follow ``path`` with the vehicle's drag and hold noise, in the air from the start."""
    knots_s = np.linspace(0.0, path.duration_s, max(int(np.ceil(path.duration_s / KNOT_S)), 8) + 1)
    push_m_s2 = GRAVITY_M_S2 * np.tan(np.radians(vehicle.tilt_std_deg))
    position, acceleration = _hold_noise(vehicle, knots_s, rng)
    size = [push_m_s2, push_m_s2, vehicle.altitude_std_m, np.radians(vehicle.heading_std_deg)]
    off = position * (size / np.array([acceleration, acceleration, 1.0, 1.0]))
    wander = make_interp_spline(knots_s, off, k=5)
    return Motion(
        path,
        (wander, wander.derivative(1), wander.derivative(2), wander.derivative(3)),
        vehicle.drag_1_s,
    )


def _hold_noise(vehicle: Vehicle, knots_s: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Stationary wander e(t) of four axes, (n, 4) with standard deviation 1, and that of its e''.

    The state of an axis is (u, d, e, e'): an Ornstein-Uhlenbeck target u, the attitude d that follows it
    with a lag, and the vehicle that d accelerates and the hold brings back: e'' = d - 2 zeta w e' - w^2 e.
    Sampled exactly, and from its stationary distribution from the first sample on.
    """
    w, tau = vehicle.hold_rad_s, vehicle.tilt_correlation_s
    hold = np.array([0.0, 1.0, -w * w, -2 * HOLD_DAMPING * w])
    follow = np.array([1.0, -1.0, 0.0, 0.0]) / ATTITUDE_LAG_S
    A = np.array([[-1 / tau, 0, 0, 0], follow, [0, 0, 0, 1], hold])
    stationary = solve_continuous_lyapunov(A, -np.diag([1.0, 0, 0, 0]))
    stationary /= stationary[2, 2]
    step = expm(A * (knots_s[1] - knots_s[0]))
    # Stationary: what a step forgets of the covariance, its noise must bring back.
    kicks = _root(stationary - step @ stationary @ step.T) @ rng.standard_normal((len(knots_s), 4, 4))
    state = _root(stationary) @ rng.standard_normal((4, 4))
    position = np.empty((len(knots_s), 4))
    for k, kick in enumerate(kicks):
        position[k] = state[2]
        state = step @ state + kick
    return position, float(np.sqrt(hold @ stationary @ hold))


def _root(covariance: Array) -> Array:
    """A matrix R with R R^T = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _tilt(slope: Array, slope_rate: Array, yaw: Array, yaw_rate: Array) -> tuple[Array, Array]:
    """Roll, pitch, yaw and body rates of a vehicle whose thrust leans by ``slope`` = (R13, R23) / R33."""
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = c * slope[:, 0] + s * slope[:, 1]
    aside = -s * slope[:, 0] + c * slope[:, 1]
    ahead_rate = c * slope_rate[:, 0] + s * slope_rate[:, 1] + yaw_rate * aside
    aside_rate = -s * slope_rate[:, 0] + c * slope_rate[:, 1] - yaw_rate * ahead
    pitch = np.arctan(ahead)
    pitch_rate = ahead_rate / (1 + ahead**2)
    lean = aside * np.cos(pitch)
    roll = -np.arctan(lean)
    roll_rate = -(aside_rate * np.cos(pitch) - aside * np.sin(pitch) * pitch_rate) / (1 + lean**2)
    body = [
        roll_rate - np.sin(pitch) * yaw_rate,
        np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
        -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
    ]
    return np.column_stack([roll, pitch, yaw]), np.column_stack(body)
