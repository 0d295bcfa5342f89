"""Compiled measurement functions of the filter: the simulator's instruments without noise.

The reading equations of the catalogue's terms are joined to one kernel for each instrument. The parameters of
all terms that change what an instrument reads form one vector.

The filter's state is that of the equations of motion (position to yaw rate), then the hold noise: noise on
the targets, the velocity noise before its pole (o) and after it (w), and the wind of gusts. The last entries
are the AR(1) noises of channels. Where there is neither, gusts and AR(1) noises are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from backend.compilation import inner_kernel
from backend.measurements import GRAVITY_M_S2
from slam.core.arrays import Array
from slam.simulation.dynamics import PITCH, ROLL, VX, VY, VZ, YAW, X, Y, Z, noise_share
from slam.simulation.terms import CATALOGUE

MOVING = 10
"""Entries of the state that the equations of motion drive."""
TARGET, BEFORE, BEHIND, GUST, AR1 = 10, 13, 16, 19, 21
"""First entries of the noise on the targets (3), o (3), w (3), gusts (2) and AR(1) noises."""

IMU, ATTITUDE, VELOCITY, SONAR = range(4)
"""Kinds of events."""
MOMENT = 4
"""Kind of an event without a reading."""
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
RANGE = FIRST_CHANNEL[SONAR]
BEYOND_IMU = range(FIRST_CHANNEL[ATTITUDE], len(CHANNELS))


def channels_of(kind: int) -> range:
    """Return the channels that events of a kind read."""
    return range(FIRST_CHANNEL[kind], FIRST_CHANNEL[kind] + WIDTH[kind])


def by_channel(*figures: float | Sequence[float] | Array) -> Array:
    """Return (channels,) from figures for each of ``INSTRUMENTS``: one for all channels, or one for each."""
    of_each = zip(figures, INSTRUMENT_CHANNELS, strict=True)
    return np.concatenate([np.broadcast_to(figure, len(channels)) for figure, channels in of_each])


def place_of(channel: int) -> tuple[int, int]:
    """Return the kind of the events that read a channel, and its column there."""
    kind, column = np.argwhere(channel == CHANNEL_AT)[0]
    return int(kind), int(column)


STREAMS = ("imu", "attitude", "velocity", "sonar")
"""Streams of the filter's kinds of events, in their order."""
SENSOR = (
    *(f"{t.name}.{p.name}" for t in CATALOGUE.values() if t.stream in STREAMS for p in t.smooth),
    "sonar.datum_m", "attitude.delay_s", "velocity.delay_s",
)  # fmt: skip
"""Entries of the instruments' parameter vector; the last three belong to no term."""
_OWNERS = [entry.partition(".")[0] for entry in SENSOR]
READ_BY = tuple(STREAMS.index(CATALOGUE[own].stream if own in CATALOGUE else own) for own in _OWNERS)
"""Kind of the events that read each entry."""
_NONE = -1
RATES_READ = (
    (VX, VY, VZ, ROLL, PITCH, YAW), (ROLL, PITCH, YAW, _NONE, _NONE, _NONE), (X, Y, VX, VY, ROLL, PITCH),
    (X, Y, Z, VZ, ROLL, PITCH),
)  # fmt: skip
"""For each kind of event, entries of the state's rate that its reading may depend on, ..."""
STATES_READ = (
    (ROLL, PITCH, YAW, _NONE, _NONE, _NONE), (ROLL, PITCH, YAW, _NONE, _NONE, _NONE),
    (Z, YAW, _NONE, _NONE, _NONE, _NONE), (X, Y, Z, ROLL, PITCH, YAW),
)  # fmt: skip
"""... and of the state itself, the noise's acceleration aside."""


def reading_terms(stream: str) -> Callable[..., None]:
    """Return the kernel ``(out, state, rate, elapsed, sensor)`` that applies the terms of a stream in turn.

    numba neither inlines nor caches a loop over functions. Therefore the calls are written out.
    """
    # Without a module's name, a cached kernel cannot be loaded by a process that compiles its caller.
    space: dict[str, Any] = {"__name__": __name__}
    calls = []
    for term in CATALOGUE.values():
        if term.stream == stream and term.read is not None:
            space[term.name] = inner_kernel(term.read)
            first = SENSOR.index(f"{term.name}.{term.parameters[0].name}")
            calls.append(f"    {term.name}(out, state, rate, elapsed, sensor, {first})")
    name = f"terms_of_{stream}"
    source = f"def {name}(out, state, rate, elapsed, sensor):\n" + "\n".join(calls or ["    pass"])
    exec(compile(source, __file__, "exec"), space)
    joined: Callable[..., None] = inner_kernel(space[name])
    return joined


SLANT, TILT_X, TILT_Y = (SENSOR.index(name) for name in ("sonar_slant.c", "sonar_tilt.x", "sonar_tilt.y"))
RANGE_LAG, DATUM = SENSOR.index("sonar_lag.T"), SENSOR.index("sonar.datum_m")
SLOPE_X, SLOPE_Y = SENSOR.index("floor_slope.x"), SENSOR.index("floor_slope.y")
ATTITUDE_DELAY, VELOCITY_DELAY = SENSOR.index("attitude.delay_s"), SENSOR.index("velocity.delay_s")

_imu_terms, _velocity_terms, _sonar_terms = (reading_terms(s) for s in ("imu", "velocity", "sonar"))


@inner_kernel
def _imu(state: Array, rate: Array, pole_s: float, share: float, out: Array) -> None:
    sr, cr = math.sin(state[ROLL]), math.cos(state[ROLL])
    sp, cp = math.sin(state[PITCH]), math.cos(state[PITCH])
    sy, cy = math.sin(state[YAW]), math.cos(state[YAW])
    p = rate[ROLL] - sp * rate[YAW]
    q = cr * rate[PITCH] + sr * cp * rate[YAW]
    r = -sr * rate[PITCH] + cr * cp * rate[YAW]
    out[0], out[1], out[2] = p, q, r
    ax = rate[VX] + share * (state[BEFORE] - state[BEHIND]) / pole_s
    ay = rate[VY] + share * (state[BEFORE + 1] - state[BEHIND + 1]) / pole_s
    az = rate[VZ] + share * (state[BEFORE + 2] - state[BEHIND + 2]) / pole_s + GRAVITY_M_S2
    ahead, left = cy * ax + sy * ay, cy * ay - sy * ax
    down = sp * ahead + cp * az
    out[3], out[4], out[5] = cp * ahead - sp * az, cr * left + sr * down, cr * down - sr * left


@inner_kernel
def _range(state: Array, rate: Array, sensor: Array) -> float:
    """Return the range of the first echo, to first order in the beam's tilt and to second in the lag."""
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
    return float(height + sensor[SLANT] * (pencil - height))


@inner_kernel
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
        _imu(state, rate, pole_s, share, out)
        _imu_terms(out, state, rate, elapsed, sensor)
    elif kind == ATTITUDE:
        for i in range(3):
            out[i] = state[ROLL + i] - sensor[ATTITUDE_DELAY] * rate[ROLL + i]
    elif kind == VELOCITY:
        late = sensor[VELOCITY_DELAY]
        sy, cy = math.sin(state[YAW]), math.cos(state[YAW])
        vx, vy = rate[X] - late * rate[VX], rate[Y] - late * rate[VY]
        out[0], out[1] = cy * vx + sy * vy, cy * vy - sy * vx
        _velocity_terms(out, state, rate, elapsed, sensor)
    else:
        out[0] = _range(state, rate, sensor)
        _sonar_terms(out, state, rate, elapsed, sensor)
        out[0] += sensor[DATUM]
