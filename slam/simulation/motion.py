"""A flown motion: the integrated states, and what they come to at any moment between two of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.core.rotations import rotation_of
from slam.simulation.dynamics import (
    HOLD_X,
    HOLD_Y,
    NOISE,
    PITCH,
    ROLL,
    STATE,
    STEP_S,
    YAW,
    Moments,
    X,
    Y,
    Z,
    integrate,
    read_out,
)
from slam.simulation.hold_noise import NoisePath, draw_noise
from slam.simulation.model import Model
from slam.simulation.stick import Stick

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """The vehicle at n moments."""

    stamps_s: Array
    w_p_m: Array
    """(n, 3)."""
    w_v_m_s: Array
    """(n, 3) velocity that exists and is seen: that of the equations and the hold noise on top."""
    w_a_m_s2: Array
    roll_pitch_yaw_rad: Array
    """(n, 3): R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    b_rate_rad_s: Array
    """(n, 3) angular velocity in body axes: what a gyro reads."""

    @property
    def w_R_b(self) -> Array:
        """(n, 3, 3)."""
        return rotation_of(self.roll_pitch_yaw_rad)

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
        return np.asarray(np.einsum("nij,ni->nj", self.w_R_b, self.w_a_m_s2 + [0.0, 0.0, GRAVITY_M_S2]))

    @property
    def h_v_m_s(self) -> Array:
        """(n, 2) horizontal velocity in the heading frame, forward and left: what an optical flow reads."""
        c, s = np.cos(self.roll_pitch_yaw_rad[:, 2]), np.sin(self.roll_pitch_yaw_rad[:, 2])
        vx, vy = self.w_v_m_s[:, 0], self.w_v_m_s[:, 1]
        return np.column_stack([c * vx + s * vy, c * vy - s * vx])


class Trajectory(Protocol):
    """What instruments can be read along: a flight, or a vehicle that is carried."""

    @property
    def duration_s(self) -> float:
        """From 0 on."""

    def at(self, stamps_s: Array) -> State:
        """The state at any times (n,)."""


@dataclass(frozen=True)
class Motion:
    """One vehicle's flight, or a part of one."""

    states: Array
    """(steps + 1, ``dynamics.STATE``) at the nodes, ``step_s`` apart."""
    noise: NoisePath
    stick: Stick
    """As it was given; the vehicle obeys it ``latency_s`` later."""
    parameters: Array
    latency_s: float
    duration_s: float
    """The motion is known from ``begin_s`` for so long."""
    begin_s: float = 0.0
    step_s: float = STEP_S

    def at(self, stamps_s: Array) -> State:
        """The state at any times, those beyond the motion taken as its ends. (n,)."""
        stamps = np.asarray(stamps_s, dtype=float)
        t = np.clip(stamps - self.begin_s, 0.0, self.duration_s)
        node = np.minimum((t / self.step_s).astype(np.int64), len(self.states) - 2)
        # A moment that is a node to rounding is that node: no partial step from its neighbour.
        node += (node + 1) * self.step_s <= t + 1e-12
        node = np.minimum(node, len(self.states) - 1)
        past = np.maximum(t - node * self.step_s, 0.0)
        share = np.where(past > 1e-12, past / self.step_s, 0.0)[:, None]
        after = np.minimum(node + 1, len(self.states) - 1)
        noise_at = (1 - share) * self.noise.values[node] + share * self.noise.values[after]
        noise_rate = (1 - share) * self.noise.rates[node] + share * self.noise.rates[after]
        begin = self.begin_s + node * self.step_s
        now = np.maximum(self.begin_s + t, begin)
        average = self.stick.mean(begin, now, self.latency_s)
        command = self.stick.at(now, self.latency_s)
        moments = Moments(node, past * (share[:, 0] > 0), average, command, noise_at, noise_rate)
        state, rate, acceleration = read_out(self.states, self.noise.values, self.parameters, moments)
        return State(
            stamps,
            state[:, :3],
            rate[:, :3],
            acceleration,
            state[:, ROLL : YAW + 1],
            _body_rates(state, rate),
        )


def at_rest(x: float, y: float, z: float, yaw_rad: float) -> Array:
    """(``dynamics.STATE``,) a vehicle in the air, level and still."""
    state = np.zeros(len(STATE))
    state[[X, Y, Z, YAW, HOLD_X, HOLD_Y]] = x, y, z, yaw_rad, x, y
    return state


def step_count(duration_s: float) -> int:
    """How many steps cover a duration."""
    return max(int(np.ceil(duration_s / STEP_S - 1e-9)), 1)


def draw_model_noise(
    model: Model, steps: int, rngs: tuple[np.random.Generator, np.random.Generator]
) -> NoisePath:
    """The hold noise and, from the second generator, the gusts of a model."""
    sigma, tau = model.vector("gusts", "sigma", "tau")
    return draw_noise(model.hold_noise, steps, STEP_S, rngs[0], (sigma, tau), rngs[1])


def no_noise(steps: int) -> NoisePath:
    """No noise at all."""
    return NoisePath(np.zeros((steps + 1, len(NOISE))), np.zeros((steps + 1, 3)))


def simulate_motion(
    stick: Stick,
    model: Model,
    start: Array,
    noise: NoisePath | None = None,
    begin_s: float = 0.0,
    end_s: float | None = None,
) -> Motion:
    """The motion of a model's vehicle under a stick that was given beforehand.

    ``start`` (``dynamics.STATE``,) at ``begin_s``, by default the stick's whole duration is flown; ``noise``
    covers ``step_count`` that many seconds, none by default.
    """
    duration_s = (stick.duration_s if end_s is None else end_s) - begin_s
    steps = step_count(duration_s)
    noise = no_noise(steps) if noise is None else noise
    nodes = begin_s + np.arange(steps + 1, dtype=np.float64) * STEP_S
    latency = model.value("control_latency", "T")
    command = stick.mean(nodes[:-1], nodes[1:], latency)
    parameters = model.parameters()
    states = integrate(start[None], command[None], noise.values[None], parameters[None], STEP_S)[0]
    return Motion(states, noise, stick, parameters, latency, duration_s, begin_s)


def _body_rates(state: Array, rate: Array) -> Array:
    roll, pitch = state[:, ROLL], state[:, PITCH]
    roll_rate, pitch_rate, yaw_rate = rate[:, ROLL : YAW + 1].T
    return np.column_stack(
        [
            roll_rate - np.sin(pitch) * yaw_rate,
            np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
            -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
        ]
    )
