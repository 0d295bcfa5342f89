"""Kinds of errors that are injected into measured flights, each at three sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight

Array = NDArray[np.float64]
Inject = Callable[[Flight, float], Flight]
"""Flight and size to the flight with the error."""


@dataclass(frozen=True)
class Kind:
    """One kind of error."""

    inject: Inject
    sizes: tuple[float, float, float]
    words: tuple[str, ...]
    """Words of which one is in a sentence that tells the error."""
    term: str = ""
    """Term that names it, if there is one."""


def _of(stream: str, field: str, change: Callable[[Array, Array, float], Array]) -> Inject:
    """Return an error that changes the values (n, k) of a stream, given stamps, values and size."""

    def inject(flight: Flight, size: float) -> Flight:
        series = getattr(flight, stream)
        values = change(series.stamps_s, getattr(series, field).astype(float), size)
        return replace(flight, **{stream: replace(series, **{field: values})})

    return inject


def _gyro(change: Callable[[Array, Array, float], Array]) -> Inject:
    return _of("imu", "gyro_rad_s", change)


def _accel(change: Callable[[Array, Array, float], Array]) -> Inject:
    return _of("imu", "accel_m_s2", change)


def _attitude(change: Callable[[Array, Array, float], Array]) -> Inject:
    return _of("attitude", "roll_pitch_yaw_rad", change)


def _velocity(change: Callable[[Array, Array, float], Array]) -> Inject:
    return _of("velocity", "v_m_s", change)


def _sonar(change: Callable[[Array, Array, float], Array]) -> Inject:
    return _of("sonar", "range_m", change)


def _late(*streams: str) -> Inject:
    return lambda flight, size: flight.restamped(streams, lambda stamps_s: stamps_s + size)


def _scaled(t: Array, x: Array, size: float) -> Array:
    return (1.0 + size) * x


def _axis(k: int, size_of: Callable[[Array, Array, float], Array]) -> Callable[[Array, Array, float], Array]:
    """Return a change of column k alone."""

    def change(t: Array, x: Array, size: float) -> Array:
        out = x.copy()
        out[:, k] = size_of(t, x[:, k], size)
        return out

    return change


def _rows(of_stamps: Array, x: Array) -> Array:
    """Return (n,) values with the dimensions of x (n, ...)."""
    return of_stamps.reshape(-1, *[1] * (x.ndim - 1))


def _shifted(t: Array, x: Array, size: float) -> Array:
    return x + size


def _half_way(t: Array, x: Array, size: float) -> Array:
    return x + size * (t > 0.5 * (t[0] + t[-1]))


def _turned_over(t: Array, x: Array, size: float) -> Array:
    """Turn the sign over in a share of the flight at its end."""
    return np.where(_rows(t > t[-1] - size * np.ptp(t), x), -x, x)


def _swapped(a: int, b: int) -> Callable[[Array, Array, float], Array]:
    """Exchange two axes in a share of the flight at its end."""

    def change(t: Array, x: Array, size: float) -> Array:
        out, late = x.copy(), t > t[-1] - size * np.ptp(t)
        out[late, a], out[late, b] = x[late, b], x[late, a]
        return out

    return change


def _oscillating(t: Array, x: Array, size: float) -> Array:
    return x + size * _rows(np.sin(2.0 * np.pi * 7.0 * t), x)


def _noisy(t: Array, x: Array, size: float) -> Array:
    return x + np.random.default_rng(0).normal(0.0, size, x.shape)


def _rounded(t: Array, x: Array, size: float) -> Array:
    return size * np.round(x / size)


def _frozen(t: Array, x: Array, size: float) -> Array:
    """Repeat the last reading for ``size`` of every 5 seconds."""
    since = np.mod(t - t[0], 5.0)
    begin = np.searchsorted(t, t - since)
    return np.where(_rows(since < size, x), x[begin], x)


def _doubled(t: Array, x: Array, size: float) -> Array:
    return np.where(np.random.default_rng(0).uniform(size=len(t)) < size, 2.0 * x, x)


def _mirrored(t: Array, x: Array, size: float) -> Array:
    """Mirror the values about the middle of their range in a share of the flight at its end."""
    return np.where(t > t[-1] - size * np.ptp(t), np.nanmin(x) + np.nanmax(x) - x, x)


ACCEL, GYRO = ("accel",), ("gyro",)
TILT, SPEED = ("roll", "pitch", "yaw", "attitude"), ("velocity", "flow")
RANGE = ("sonar", "range", "height")
WHOLE = (0.5, 0.8, 1.0)
KINDS = {
    "gyro scale": Kind(_gyro(_scaled), (0.01, 0.03, 0.1), GYRO, "gyro_scale"),
    "gyro bias": Kind(_gyro(_axis(2, _shifted)), (0.005, 0.02, 0.05), GYRO, "gyro_bias"),
    "gyro bias half-way": Kind(_gyro(_axis(0, _half_way)), (0.005, 0.02, 0.05), GYRO, "gyro_bias"),
    "gyro axes swapped": Kind(_gyro(_swapped(0, 1)), WHOLE, (*GYRO, *TILT)),
    "gyro z turned over": Kind(_gyro(_axis(2, _turned_over)), WHOLE, (*GYRO, *TILT)),
    "gyro oscillates": Kind(_gyro(_oscillating), (0.02, 0.1, 0.5), GYRO),
    "gyro rounded": Kind(_gyro(_rounded), (0.02, 0.05, 0.1), GYRO),
    "gyro frozen": Kind(_gyro(_frozen), (0.2, 0.4, 0.6), GYRO),
    "accel scale": Kind(_accel(_scaled), (0.01, 0.03, 0.1), ACCEL, "accel_scale"),
    "accel bias": Kind(_accel(_axis(0, _shifted)), (0.1, 0.3, 0.8), ACCEL, "accel_bias"),
    "accel bias half-way": Kind(_accel(_axis(0, _half_way)), (0.1, 0.3, 0.8), ACCEL, "accel_bias"),
    "accel axes swapped": Kind(_accel(_swapped(0, 1)), WHOLE, (*ACCEL, *SPEED)),
    "accel oscillates": Kind(_accel(_oscillating), (0.3, 1.0, 5.0), ACCEL),
    "accel noise": Kind(_accel(_noisy), (0.3, 1.0, 5.0), ACCEL),
    "accel frozen": Kind(_accel(_frozen), (0.2, 0.4, 0.6), ACCEL),
    "attitude rounded": Kind(_attitude(_rounded), (0.003, 0.0175, 0.05), TILT),
    "attitude late": Kind(_late("attitude"), (0.01, 0.03, 0.08), TILT),
    "attitude frozen": Kind(_attitude(_frozen), (0.2, 0.4, 0.6), TILT),
    "roll turned over": Kind(_attitude(_axis(0, _turned_over)), WHOLE, TILT),
    "roll and pitch swapped": Kind(_attitude(_swapped(0, 1)), WHOLE, TILT),
    "velocity axes swapped": Kind(_velocity(_swapped(0, 1)), WHOLE, SPEED),
    "velocity turned over": Kind(_velocity(_turned_over), WHOLE, SPEED),
    "velocity short": Kind(_velocity(_scaled), (-0.05, -0.1, -0.3), SPEED, "flow_scale"),
    "velocity long": Kind(_velocity(_scaled), (0.05, 0.1, 0.3), SPEED, "flow_scale"),
    "velocity late": Kind(_late("velocity"), (0.02, 0.04, 0.12), SPEED),
    "velocity bias half-way": Kind(_velocity(_axis(0, _half_way)), (0.1, 0.3, 1.0), (*SPEED, "speed")),
    "velocity oscillates": Kind(_velocity(_oscillating), (0.05, 0.2, 0.5), SPEED),
    "velocity frozen": Kind(_velocity(_frozen), (0.2, 0.4, 0.6), SPEED),
    "velocity rounded": Kind(_velocity(_rounded), (0.02, 0.1, 0.3), SPEED),
    "sonar scale": Kind(_sonar(_scaled), (0.02, 0.06, 0.15), RANGE, "sonar_scale"),
    "sonar late": Kind(_late("sonar"), (0.02, 0.08, 0.2), RANGE, "sonar_lag"),
    "sonar frozen": Kind(_sonar(_frozen), (0.2, 0.4, 0.6), RANGE),
    "sonar rounded": Kind(_sonar(_rounded), (0.01, 0.03, 0.1), RANGE, "sonar_quantisation"),
    "sonar spikes": Kind(_sonar(_doubled), (0.005, 0.02, 0.1), RANGE, "sonar_spikes"),
    "sonar turned over": Kind(_sonar(_mirrored), WHOLE, RANGE),
}
STREAM = {
    "gyro": "imu", "accel": "imu", "attitude": "attitude", "roll": "attitude", "velocity": "velocity",
    "sonar": "sonar",
}  # fmt: skip
"""First word of a kind -> stream that it changes."""
