"""Compiled measurement functions of the filter: the simulator's instruments without noise.

The filter's state is that of the equations of motion (position to yaw rate), then the hold noise: noise on
the targets, the velocity noise before its pole (o) and after it (w), and the wind of gusts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.criticism.kalman.compiled import kernel
from slam.simulation.dynamics import PITCH, ROLL, VX, VY, VZ, YAW, X, Y, Z, noise_share

Array = NDArray[np.float64]

MOVING = 10
"""Entries of the state that the equations of motion drive."""
TARGET, BEFORE, BEHIND, GUST = 10, 13, 16, 19
"""First entries of the noise on the targets (3), o (3), w (3) and gusts (2)."""
STATES, STATES_WITH_GUSTS = 19, 21

IMU, ATTITUDE, VELOCITY, SONAR = range(4)
"""Kinds of events."""
FIRST_CHANNEL = (0, 6, 9, 11)
CHANNELS = (
    "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z",
    "roll", "pitch", "yaw", "velocity_x", "velocity_y", "range",
)  # fmt: skip
"""Names of the scalar channels; those of kind k begin at ``FIRST_CHANNEL[k]``."""
CHANNEL_UNITS = ("rad/s",) * 3 + ("m/s^2",) * 3 + ("rad",) * 3 + ("m/s",) * 2 + ("m",)
WIDTH = (6, 3, 2, 1)
"""Channels of each kind."""
NO_CHANNEL = -1
CHANNEL_AT = np.array(
    [
        [first + column if column < width else NO_CHANNEL for column in range(max(WIDTH))]
        for first, width in zip(FIRST_CHANNEL, WIDTH, strict=True)
    ]
)
"""(kinds, 6) channel in each column of an event's values; ``NO_CHANNEL`` for unused columns."""
INSTRUMENTS = ("gyro", "accel", "attitude", "velocity", "sonar")
INSTRUMENT_CHANNELS = (range(3), range(3, 6), range(6, 9), range(9, 11), range(11, 12))
"""Channels of each instrument, which share a kind of noise."""
INSTRUMENT_OF = tuple(k for k, channels in enumerate(INSTRUMENT_CHANNELS) for _ in channels)
"""Instrument of each channel."""
RANGE = FIRST_CHANNEL[SONAR]
BEYOND_IMU = range(FIRST_CHANNEL[ATTITUDE], len(CHANNELS))


def channels_of(kind: int) -> range:
    """Return the channels that events of a kind read."""
    return range(FIRST_CHANNEL[kind], FIRST_CHANNEL[kind] + WIDTH[kind])


def by_channel(*figures: float | Sequence[float]) -> Array:
    """Return (channels,) from figures for each of ``INSTRUMENTS``: one for all channels, or one for each."""
    of_each = zip(figures, INSTRUMENT_CHANNELS, strict=True)
    return np.concatenate([np.broadcast_to(figure, len(channels)) for figure, channels in of_each])


def place_of(channel: int) -> tuple[int, int]:
    """Return the kind of the events that read a channel, and its column there."""
    kind, column = np.argwhere(channel == CHANNEL_AT)[0]
    return int(kind), int(column)


SENSOR = (
    "flow_scale.eps", "flow_derotation.kappa",
    "sonar_slant.c", "sonar_tilt.x", "sonar_tilt.y", "sonar_scale.eps", "sonar_bias.b",
    "sonar_temperature.rise", "sonar_lag.T", "sonar.datum_m",
    "gyro_bias.x", "gyro_bias.y", "gyro_bias.z", "gyro_scale.eps",
    "accel_bias.x", "accel_bias.y", "accel_bias.z", "accel_scale.eps",
    "imu_misalignment.x", "imu_misalignment.y", "imu_misalignment.z",
    "floor_slope.x", "floor_slope.y",
    "attitude.delay_s", "velocity.delay_s",
)  # fmt: skip
"""Entries of the instruments' parameter vector; the last two belong to residual patterns, not to terms."""

(
    FLOW_SCALE, DEROTATION, SLANT, TILT_X, TILT_Y, RANGE_SCALE, RANGE_BIAS, WARMING, RANGE_LAG, DATUM,
    GYRO_X, GYRO_Y, GYRO_Z, GYRO_SCALE, ACCEL_X, ACCEL_Y, ACCEL_Z, ACCEL_SCALE, TURN_X, TURN_Y, TURN_Z,
    SLOPE_X, SLOPE_Y, ATTITUDE_DELAY, VELOCITY_DELAY,
) = range(len(SENSOR))  # fmt: skip

ASSUMED_SOUND_M_S, SOUND_M_S_K = 331.3 + 0.606 * 20.0, 0.606
"""Speed of sound in m/s that the sonar assumes, and its change per kelvin."""


@kernel
def _turned(x: float, y: float, z: float, sensor: Array, out: Array, first: int) -> None:
    """Write a vector in axes turned by a small rotation vector m: v - m x v + m x (m x v) / 2."""
    a, b, c = sensor[TURN_X], sensor[TURN_Y], sensor[TURN_Z]
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    out[first] = x - u + 0.5 * (b * w - c * v)
    out[first + 1] = y - v + 0.5 * (c * u - a * w)
    out[first + 2] = z - w + 0.5 * (a * v - b * u)


@kernel
def _imu(state: Array, rate: Array, sensor: Array, pole_s: float, share: float, out: Array) -> None:
    sr, cr, sp, cp = (
        math.sin(state[ROLL]),
        math.cos(state[ROLL]),
        math.sin(state[PITCH]),
        math.cos(state[PITCH]),
    )
    sy, cy = math.sin(state[YAW]), math.cos(state[YAW])
    p = rate[ROLL] - sp * rate[YAW]
    q = cr * rate[PITCH] + sr * cp * rate[YAW]
    r = -sr * rate[PITCH] + cr * cp * rate[YAW]
    _turned(p, q, r, sensor, out, 0)
    ax = rate[VX] + share * (state[BEFORE] - state[BEHIND]) / pole_s
    ay = rate[VY] + share * (state[BEFORE + 1] - state[BEHIND + 1]) / pole_s
    az = rate[VZ] + share * (state[BEFORE + 2] - state[BEHIND + 2]) / pole_s + GRAVITY_M_S2
    ahead, left = cy * ax + sy * ay, cy * ay - sy * ax
    down = sp * ahead + cp * az
    _turned(cp * ahead - sp * az, cr * left + sr * down, cr * down - sr * left, sensor, out, 3)
    for i in range(3):
        out[i] = (1.0 + sensor[GYRO_SCALE]) * out[i] + sensor[GYRO_X + i]
        out[3 + i] = (1.0 + sensor[ACCEL_SCALE]) * out[3 + i] + sensor[ACCEL_X + i]


@kernel
def _range(state: Array, rate: Array, sensor: Array, elapsed: float) -> float:
    """Return the range along the beam, to first order in the beam's tilt and to second in the lag."""
    late = sensor[RANGE_LAG]
    z = state[Z] - late * rate[Z] + 0.5 * late * late * rate[VZ]
    roll, pitch = state[ROLL] - late * rate[ROLL], state[PITCH] - late * rate[PITCH]
    x, y = state[X] - late * rate[X], state[Y] - late * rate[Y]
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(state[YAW]), math.cos(state[YAW])
    bx, by = -sensor[TILT_Y], sensor[TILT_X]
    # The beam in the world: R_wb (bx, by, -1), its first two entries for the slope alone.
    side = sr * by - cr
    ahead, left = cp * bx + sp * side, cr * by + sr
    up = -sp * bx + cp * side
    wx, wy = cy * ahead - sy * left, sy * ahead + cy * left
    slope_x, slope_y = sensor[SLOPE_X], sensor[SLOPE_Y]
    height = z - slope_x * x - slope_y * y
    pencil = height / (-up + slope_x * wx + slope_y * wy)
    echo = height + sensor[SLANT] * (pencil - height)
    warm = ASSUMED_SOUND_M_S + SOUND_M_S_K * sensor[WARMING] * elapsed
    echo *= ASSUMED_SOUND_M_S / warm * (1.0 + sensor[RANGE_SCALE])
    return float(echo + sensor[RANGE_BIAS] + sensor[DATUM])


@kernel
def reading(
    kind: int,
    state: Array,
    rate: Array,
    sensor: Array,
    parameters: Array,
    pole_s: float,
    elapsed: float,
    out: Array,
) -> None:
    """Write the reading of an instrument into ``out`` (6,).

    ``rate`` (>= 10,) is the state's rate from the equations, ``sensor`` (``SENSOR``,), ``elapsed`` the share
    of the flight's duration that is over.
    """
    share = noise_share(state[Z], parameters)
    if kind == IMU:
        _imu(state, rate, sensor, pole_s, share, out)
    elif kind == ATTITUDE:
        for i in range(3):
            out[i] = state[ROLL + i] - sensor[ATTITUDE_DELAY] * rate[ROLL + i]
    elif kind == VELOCITY:
        late = sensor[VELOCITY_DELAY]
        sy, cy = math.sin(state[YAW]), math.cos(state[YAW])
        vx, vy = rate[X] - late * rate[VX], rate[Y] - late * rate[VY]
        # Small tilts: the body's rates about x and y are those of roll and pitch.
        turning = sensor[DEROTATION] * state[Z]
        out[0] = (1.0 + sensor[FLOW_SCALE]) * (cy * vx + sy * vy + turning * rate[PITCH])
        out[1] = (1.0 + sensor[FLOW_SCALE]) * (cy * vy - sy * vx - turning * rate[ROLL])
    else:
        out[0] = _range(state, rate, sensor, elapsed)
