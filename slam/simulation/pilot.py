"""A pilot that follows way points: it controls the vehicle along a planned path by stick commands.

The feed-forward part is the tilt for the acceleration and the drag of the path, ahead by the vehicle's lag.
The feedback part is proportional to the error in position and speed. The pilot knows the nominal vehicle of
the model but not its terms, whose effects the feedback corrects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.simulation.dynamics import DISCHARGE, STEP_S, VX, VZ, YAW, YAW_RATE, X, Z, integrate
from slam.simulation.hold_noise import NoisePath
from slam.simulation.manoeuvre import FlightPath
from slam.simulation.model import Model, Vehicle
from slam.simulation.motion import Motion, at_rest, step_count
from slam.simulation.stick import Stick

Array = NDArray[np.float64]

TICK_STEPS = 20
"""Steps of the integration for each command, which gives 25 commands a second."""
TICK_S = TICK_STEPS * STEP_S
PLACE_1_S2, SPEED_1_S = 5.0, 3.2
"""Feedback gains of position and speed: a natural frequency of 2.2 rad/s with damping 0.7."""
CLIMB_1_S, TURN_1_S = 2.5, 3.0
"""Feedback gains of height and yaw."""
MAX_TILT_RAD = 0.35
"""Largest tilt that the pilot commands."""


@dataclass(frozen=True)
class Pilot:
    """Controller for a nominal vehicle."""

    vehicle: Vehicle

    def stick(self, state: list[float], target: Array) -> tuple[float, float, float, float]:
        """Return the commands forward, left, up and yaw in -1..1.

        ``state`` is ``dynamics.STATE`` at the tick. ``target`` (4, 4) is x, y, z, yaw of the path and its
        derivatives half a tick later, in the middle of the interval of the command.
        """
        p, v, a, jerk = target.tolist()
        vehicle, half = self.vehicle, TICK_S / 2
        push, push_rate = [0.0, 0.0], [0.0, 0.0]
        for axis in range(2):
            behind = p[axis] - state[X + axis] - half * state[VX + axis]
            slower = v[axis] - state[VX + axis] - half * a[axis]
            push[axis] = a[axis] + vehicle.drag_1_s * v[axis] + PLACE_1_S2 * behind + SPEED_1_S * slower
            push_rate[axis] = jerk[axis] + vehicle.drag_1_s * a[axis] + PLACE_1_S2 * slower
        # Predict the target tilt by one lag, which cancels the first-order lag.
        roll, pitch = tilt_for(
            [push[k] + vehicle.attitude_time_s * push_rate[k] for k in range(2)],
            state[YAW] + vehicle.attitude_time_s * state[YAW_RATE],
        )
        reach = vehicle.max_tilt_rad * vehicle.gain
        most = min(MAX_TILT_RAD / reach, 1.0)
        climb = v[2] + vehicle.climb_time_s * a[2] + CLIMB_1_S * (p[2] - state[Z] - half * state[VZ])
        turn = v[3] + vehicle.yaw_time_s * a[3] + TURN_1_S * (p[3] - state[YAW] - half * state[YAW_RATE])
        return (
            _within(pitch / reach, most),
            _within(-roll / reach, most),
            _within(climb / vehicle.climb_rate_m_s, 1.0),
            _within(turn / vehicle.yaw_rate_rad_s, 1.0),
        )


def tilt_for(push_m_s2: list[float], yaw: float) -> tuple[float, float]:
    """Return the roll and pitch that accelerate by ``push_m_s2`` (x, y) in the world at constant height."""
    c, s = math.cos(yaw), math.sin(yaw)
    ahead = (c * push_m_s2[0] + s * push_m_s2[1]) / GRAVITY_M_S2
    to_left = (c * push_m_s2[1] - s * push_m_s2[0]) / GRAVITY_M_S2
    pitch = math.atan(ahead)
    return -math.atan(to_left * math.cos(pitch)), pitch


def fly(path: FlightPath, model: Model, noise: NoisePath) -> Motion:
    """Fly along ``path``, initially at rest; ``noise`` has ``step_count(path.duration_s)`` steps."""
    steps = step_count(path.duration_s)
    ticks = -(-steps // TICK_STEPS)
    stamps = np.arange(ticks, dtype=np.float64) * TICK_S
    ahead = np.minimum(stamps + TICK_S / 2, path.duration_s)
    target = np.stack([derivative(ahead) for derivative in path.derivatives], axis=1)
    begin = path.derivatives[0](0.0)
    pilot, parameters = Pilot(model.vehicle), model.parameters()[None]
    latency = model.value("control_latency", "T")
    delay_ticks, new = _delay(latency)
    states = np.empty((steps + 1, len(at_rest(0, 0, 0, 0))))
    states[0] = at_rest(*begin)
    sticks = np.zeros((ticks, 4))
    for k in range(ticks):
        first, last = k * TICK_STEPS, min((k + 1) * TICK_STEPS, steps)
        sticks[k] = pilot.stick(states[first].tolist(), target[k])
        command = _delayed_command(sticks, k - delay_ticks, new[: last - first])
        command[:, DISCHARGE] = (np.arange(first, last) + 0.5) * STEP_S / path.duration_s
        states[first : last + 1] = integrate(
            states[None, first], command[None], noise.values[None, first : last + 1], parameters, STEP_S
        )[0]
    stick = Stick(stamps, sticks, path.duration_s)
    return Motion(
        states=states,
        noise=noise,
        stick=stick,
        parameters=parameters[0],
        latency_s=latency,
        duration_s=path.duration_s,
    )


def _delay(latency_s: float) -> tuple[int, Array]:
    """Return a latency in whole ticks, and the share (n,) of each step of a tick with the new command."""
    ticks = int(latency_s / TICK_S + 1e-9)
    rest_steps = (latency_s - ticks * TICK_S) / STEP_S
    return ticks, np.clip(np.arange(1, TICK_STEPS + 1) - rest_steps, 0.0, 1.0)


def _delayed_command(sticks: Array, k: int, new: Array) -> Array:
    """Return the mean commands (n, 6) over the steps of a tick in which command k replaces k - 1."""
    now, before = (sticks[j] if j >= 0 else np.zeros(4) for j in (k, k - 1))
    centred = [float(stick[0] == 0 and stick[1] == 0) for stick in (now, before)]
    return np.column_stack(
        [
            new[:, None] * now + (1 - new[:, None]) * before,
            new * centred[0] + (1 - new) * centred[1],
            np.zeros_like(new),
        ]
    )


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
