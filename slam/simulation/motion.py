"""The motion of one flight: integrated states, evaluated at any time."""

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
    VX,
    YAW,
    YAW_RATE,
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
    """State of the vehicle at n moments."""

    stamps_s: Array
    w_p_m: Array
    """(n, 3) position."""
    w_v_m_s: Array
    """(n, 3) full velocity: that of the equations plus the hold noise."""
    w_a_m_s2: Array
    roll_pitch_yaw_rad: Array
    """(n, 3): R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    b_rate_rad_s: Array
    """(n, 3) angular velocity in body axes, as a gyro measures it."""

    @property
    def w_R_b(self) -> Array:
        """(n, 3, 3) rotations."""
        return rotation_of(self.roll_pitch_yaw_rad)

    @property
    def w_T_b(self) -> Array:
        """(n, 4, 4) poses."""
        pose = np.tile(np.eye(4), (len(self.stamps_s), 1, 1))
        pose[:, :3, :3] = self.w_R_b
        pose[:, :3, 3] = self.w_p_m
        return pose

    @property
    def vectors(self) -> tuple[Array, Array]:
        """State and its derivative, (``STATE``, n) each, as the equations have them; set points are 0."""
        state, rate = np.zeros((2, len(STATE), len(self.stamps_s)))
        state[X:VX], state[VX:ROLL], state[ROLL:YAW_RATE] = (
            self.w_p_m.T, self.w_v_m_s.T, self.roll_pitch_yaw_rad.T,
        )  # fmt: skip
        rate[X:VX], rate[VX:ROLL] = self.w_v_m_s.T, self.w_a_m_s2.T
        (roll, pitch, _), (p, q, r) = self.roll_pitch_yaw_rad.T, self.b_rate_rad_s.T
        rate[YAW] = (np.sin(roll) * q + np.cos(roll) * r) / np.cos(pitch)
        rate[ROLL], rate[PITCH] = p + np.sin(pitch) * rate[YAW], np.cos(roll) * q - np.sin(roll) * r
        state[YAW_RATE] = rate[YAW]
        return state, rate

    @property
    def b_specific_force_m_s2(self) -> Array:
        """(n, 3) specific force R_wb^T (a + (0, 0, g)), as an accelerometer measures it."""
        return np.asarray(np.einsum("nij,ni->nj", self.w_R_b, self.w_a_m_s2 + [0.0, 0.0, GRAVITY_M_S2]))

    @property
    def h_v_m_s(self) -> Array:
        """(n, 2) velocity forward and left in the heading frame, as an optical flow measures it."""
        c, s = np.cos(self.roll_pitch_yaw_rad[:, 2]), np.sin(self.roll_pitch_yaw_rad[:, 2])
        vx, vy = self.w_v_m_s[:, 0], self.w_v_m_s[:, 1]
        return np.column_stack([c * vx + s * vy, c * vy - s * vx])


class Trajectory(Protocol):
    """A motion that instruments can measure: a flight, or a vehicle that is carried."""

    @property
    def duration_s(self) -> float:
        """Duration; the motion begins at 0."""

    def at(self, stamps_s: Array) -> State:
        """Return the state at any times (n,)."""


@dataclass(frozen=True)
class Motion:
    """The flight of one vehicle, or a part of it."""

    states: Array
    """(steps + 1, ``dynamics.STATE``) states at the nodes, ``step_s`` apart."""
    noise: NoisePath
    stick: Stick
    """Commands as the pilot gave them; the vehicle responds ``latency_s`` later."""
    parameters: Array
    latency_s: float
    duration_s: float
    """Duration of the motion, from ``begin_s`` on."""
    begin_s: float = 0.0
    step_s: float = STEP_S

    def at(self, stamps_s: Array) -> State:
        """Return the state at any times (n,). Times outside the motion give its first or last state."""
        stamps = np.asarray(stamps_s, dtype=float)
        t = np.clip(stamps - self.begin_s, 0.0, self.duration_s)
        node = np.minimum((t / self.step_s).astype(np.int64), len(self.states) - 2)
        # A moment within rounding of a node is that node, without a partial step from its neighbour.
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
    """Return the state (``dynamics.STATE``,) of a vehicle in the air, level and at rest."""
    state = np.zeros(len(STATE))
    state[[X, Y, Z, YAW, HOLD_X, HOLD_Y]] = x, y, z, yaw_rad, x, y
    return state


def step_count(duration_s: float) -> int:
    """Return how many steps cover a duration."""
    return max(int(np.ceil(duration_s / STEP_S - 1e-9)), 1)


def draw_model_noise(
    model: Model, steps: int, rngs: tuple[np.random.Generator, np.random.Generator]
) -> NoisePath:
    """Draw the hold noise of a model from the first generator and its gusts from the second."""
    sigma, tau = model.vector("gusts", "sigma", "tau")
    return draw_noise(model.hold_noise, steps, STEP_S, rngs[0], (sigma, tau), rngs[1])


def no_noise(steps: int) -> NoisePath:
    """Return a noise that is zero everywhere."""
    return NoisePath(np.zeros((steps + 1, len(NOISE))), np.zeros((steps + 1, 3)))


def simulate_motion(
    stick: Stick,
    model: Model,
    start: Array,
    noise: NoisePath | None = None,
    begin_s: float = 0.0,
    end_s: float | None = None,
) -> Motion:
    """Integrate the motion of a model's vehicle under given commands, open loop.

    ``start`` (``dynamics.STATE``,) is the state at ``begin_s``. The motion ends at ``end_s``, by default at
    the end of the stick. ``noise`` has ``step_count`` steps for that duration; the default is none.
    """
    duration_s = (stick.duration_s if end_s is None else end_s) - begin_s
    steps = step_count(duration_s)
    noise = no_noise(steps) if noise is None else noise
    nodes = begin_s + np.arange(steps + 1, dtype=np.float64) * STEP_S
    latency = model.value("control_latency", "T")
    command = stick.mean(nodes[:-1], nodes[1:], latency)
    parameters = model.parameters()
    states = integrate(start[None], command[None], noise.values[None], parameters[None], STEP_S)[0]
    return Motion(
        states=states,
        noise=noise,
        stick=stick,
        parameters=parameters,
        latency_s=latency,
        duration_s=duration_s,
        begin_s=begin_s,
    )


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
