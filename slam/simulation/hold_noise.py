"""Hold noise of a hover: disturbances of tilt and yaw, and an additional velocity.

Each channel is an Ornstein-Uhlenbeck process, drawn at the nodes of the integration and linear between them.
So it is one continuous function of time for all instruments. The velocity noise then passes a first-order
pole. Its derivative is known, which the accelerometer needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam.core.recursion import recursion

Array = NDArray[np.float64]
Time = Annotated[float, Field(ge=0.01, le=60)]
Size = Annotated[float, Field(ge=0, le=20)]


@dataclass(frozen=True)
class HoldNoise:
    """Standard deviations and correlation times of a process that is stationary from the start."""

    tilt_std_deg: Size = 0.4
    """Standard deviation of the noise added to the targets of roll and pitch."""
    tilt_correlation_s: Time = 0.25
    yaw_rate_std_deg_s: Size = 1.0
    """Standard deviation of the noise added to the target of the yaw rate."""
    yaw_rate_correlation_s: Time = 0.35
    velocity_std_m_s: Annotated[float, Field(ge=0, le=5)] = 0.034
    """Standard deviation in x and in y, after the pole."""
    velocity_up_std_m_s: Annotated[float, Field(ge=0, le=5)] = 0.012
    velocity_correlation_s: Time = 0.11
    """Correlation time before the pole."""
    velocity_pole_s: Annotated[float, Field(ge=0.005, le=5)] = 0.02
    fade_height_m: Annotated[float, Field(ge=0.001, le=5)] = 0.04
    """Height above touchdown over which the noise fades to zero."""


@dataclass(frozen=True)
class NoisePath:
    """One realisation of the noise at the nodes of an integration."""

    values: Array
    """(steps + 1, ``dynamics.NOISE``) values."""
    rates: Array
    """(steps + 1, 3) derivative of the velocity noise w [m/s^2]."""


def draw_noise(
    noise: HoldNoise,
    steps: int,
    step_s: float,
    rng: np.random.Generator,
    gusts: tuple[float, float] = (0.0, 1.0),
    gust_rng: np.random.Generator | None = None,
) -> NoisePath:
    """Draw the noise for ``steps`` steps. A longer realisation begins with the shorter one.

    ``gusts`` are the standard deviation in m/s and the correlation time in s of the wind, drawn from
    ``gust_rng``.
    """
    first = rng.standard_normal(3)
    white = rng.standard_normal((steps + 1, 6))
    values, rates = np.zeros((steps + 1, 8)), np.zeros((steps + 1, 3))
    tilt, turn = np.radians(noise.tilt_std_deg), np.radians(noise.yaw_rate_std_deg_s)
    values[:, 0] = tilt * _process(white[:, 0], step_s / noise.tilt_correlation_s)
    values[:, 1] = tilt * _process(white[:, 1], step_s / noise.tilt_correlation_s)
    values[:, 2] = turn * _process(white[:, 2], step_s / noise.yaw_rate_correlation_s)
    for axis, std in enumerate((noise.velocity_std_m_s, noise.velocity_std_m_s, noise.velocity_up_std_m_s)):
        before = _process(white[:, 3 + axis], step_s / noise.velocity_correlation_s)
        after, push, size = _pole(before, first[axis], step_s, noise)
        values[:, 3 + axis] = std / size * after
        rates[:, axis] = std / size * push
    sigma, tau = gusts
    if sigma > 0 and gust_rng is not None:
        white = gust_rng.standard_normal((steps + 1, 2))
        for axis in range(2):
            values[:, 6 + axis] = sigma * _process(white[:, axis], step_s / tau)
    return NoisePath(values, rates)


def _process(white: Array, step: float) -> Array:
    """Return an Ornstein-Uhlenbeck process (n,) of variance 1; ``step`` is in correlation times."""
    keep = np.exp(-step)
    kicks = np.sqrt(-np.expm1(-2 * step)) * white
    kicks[0] = white[0]
    return recursion(kicks, keep)


def _pole(before: Array, first: float, step_s: float, noise: HoldNoise) -> tuple[Array, Array, float]:
    """Return value and derivative after the pole at the nodes, and the value's standard deviation.

    ``first`` is the standard normal deviate of the first value, conditional on the process o. The pole's
    equation w' = (o - w) / T is solved exactly for o linear between the nodes.
    """
    x, a = step_s / noise.velocity_pole_s, np.exp(-step_s / noise.velocity_pole_s)
    from_end = 1 - (1 - a) / x
    from_begin = (1 - a) - from_end
    # Stationary covariance of w and o, then variance of w: w_k+1 = a w_k + from_begin o_k + from_end o_k+1.
    b = np.exp(-step_s / noise.velocity_correlation_s)
    with_o = (from_begin * b + from_end) / (1 - a * b)
    drive = from_begin**2 + from_end**2 + 2 * b * from_begin * from_end
    variance = (drive + 2 * a * with_o * (from_begin + from_end * b)) / (1 - a * a)
    kicks = np.empty_like(before)
    kicks[1:] = from_begin * before[:-1] + from_end * before[1:]
    kicks[0] = with_o * before[0] + np.sqrt(max(variance - with_o**2, 0.0)) * first
    after = recursion(kicks, a)
    return after, (before - after) / noise.velocity_pole_s, float(np.sqrt(variance))
