"""Channels of a flight's vehicle streams, each with its unit and the noise that the recording states."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Imu, Sonar, Velocity

Array = NDArray[np.float64]
_Series = Imu | AttitudeSeries | Velocity | Sonar

FEWEST = 100
NOISY = 3.0
"""Ratio of the noise to the stated figure, half an order of magnitude, beyond which readings are judged by
their scatter. It is reported too, and so is a noise that is smaller by this factor."""
DOUBLED = 2.0**0.5
"""Ratio beyond which it is reported where an instrument states its noise and motion is slow beside its
readings: from there on twice is nearer than once. In the blind cases of the test data, whose noise is 0.8 to
1.2 times the stated one, the greatest ratio of attitude, velocity and sonar is 1.31. That of the imu is 1.87,
as it reads the jumps of the stick."""
SUDDEN = "gyro", "accel"
"""Instruments whose readings change suddenly as the vehicle moves."""


@dataclass(frozen=True)
class InstrumentReadings:
    """The readings of one instrument."""

    name: str
    stamps_s: Array
    """(n,)."""
    values: Array
    """(n, channels)."""
    channels: tuple[str, ...]
    unit: str
    noise_std: Array
    """(channels,) standard deviation of one reading, as stated or assumed."""
    noise_assumed: bool = False
    """Whether the recording does not state it."""


def noise_ratio(stream: InstrumentReadings) -> float:
    """Return the noise of single readings over the stated one, of the worst channel; 0 if nothing is stated.

    The second difference of white noise has a standard deviation of sqrt(6) that of a reading (von Neumann,
    1941), and motion is slow beside it. Repeated readings are left out.
    """
    finite = stream.values[np.isfinite(stream.values).all(axis=1)]
    readings = finite[1:][np.any(np.diff(finite, axis=0) != 0.0, axis=1)]
    if len(readings) < FEWEST:
        return 0.0
    second = np.diff(readings, n=2, axis=0)
    std = np.array([robust_std(column) for column in second.T]) / np.sqrt(6.0)
    stated = stream.noise_std > 0.0
    return float(np.max(std[stated] / stream.noise_std[stated], initial=0.0))


def misstated_noise(flights: Sequence[Flight]) -> list[str]:
    """Return sentences on instruments whose readings scatter more, or far less, than the recording states.

    A noise that is assumed is never too large: it says no more than how far instruments of the kind scatter.
    """
    ratios: dict[tuple[str, bool], float] = {}
    for stream in (s for flight in flights for s in streams_of(flight)):
        key = stream.name, stream.noise_assumed
        ratios[key] = max(ratios.get(key, 0.0), noise_ratio(stream))
    told = defaultdict[str, list[str]](list)
    for (name, is_assumed), ratio in ratios.items():
        if ratio > (NOISY if is_assumed or name in SUDDEN else DOUBLED):
            told[f"larger than {'assumed' if is_assumed else 'stated'}"].append(f"{name} {ratio:.2g} times")
        elif 0.0 < ratio < 1.0 / NOISY and not is_assumed:
            told["smaller than stated, as behind a filter"].append(f"{name} {ratio:.2g} times")
    return [f"Noise from reading to reading is {how}: {', '.join(each)}." for how, each in told.items()]


def with_scattering_noise(flight: Flight) -> Flight:
    """Return the flight with the noise of its readings where that is far larger than stated. A smaller one
    stays as stated: what a filter hides from reading to reading is there over longer times."""
    ratios = {stream.name: noise_ratio(stream) for stream in streams_of(flight)}
    factor = {name: ratio if ratio > NOISY else 1.0 for name, ratio in ratios.items()}
    if (imu := flight.imu) is not None and "gyro" in factor:
        gyro, accel = imu.gyro_noise_density * factor["gyro"], imu.accel_noise_density * factor["accel"]
        flight = replace(flight, imu=replace(imu, gyro_noise_density=gyro, accel_noise_density=accel))
    if (attitude := flight.attitude) is not None:
        roll, pitch, yaw = (std * factor["attitude"] for std in attitude.noise_std_rad)
        flight = replace(flight, attitude=replace(attitude, noise_std_rad=(roll, pitch, yaw)))
    if (velocity := flight.velocity) is not None:
        ahead, left = (std * factor["velocity"] for std in velocity.noise_std_m_s)
        flight = replace(flight, velocity=replace(velocity, noise_std_m_s=(ahead, left)))
    if (sonar := flight.sonar) is not None:
        flight = replace(flight, sonar=replace(sonar, noise_std_m=sonar.noise_std_m * factor["sonar"]))
    return flight


def streams_of(flight: Flight) -> list[InstrumentReadings]:
    """Return gyro, accelerometer, attitude, velocity and sonar, as far as the flight has them."""
    found = list[InstrumentReadings]()

    def add(
        name: str, series: _Series, values: Array, channels: Sequence[str], unit: str, std: Array
    ) -> None:
        stated = std, series.noise_assumed
        found.append(InstrumentReadings(name, series.stamps_s, values, tuple(channels), unit, *stated))

    if (imu := flight.imu) is not None and len(imu.stamps_s) > 1:
        root = 1.0 / np.sqrt(max(float(np.median(np.diff(imu.stamps_s))), 1e-6))
        for name, values, unit, density in (
            ("gyro", imu.gyro_rad_s, "rad/s", imu.gyro_noise_density),
            ("accel", imu.accel_m_s2, "m/s^2", imu.accel_noise_density),
        ):
            add(name, imu, values, [f"{name}_{axis}" for axis in "xyz"], unit, np.full(3, density * root))
    if (attitude := flight.attitude) is not None:
        std, angles = np.array(attitude.noise_std_rad), ("roll", "pitch", "yaw")
        add("attitude", attitude, attitude.roll_pitch_yaw_rad, angles, "rad", std)
    if (velocity := flight.velocity) is not None:
        std, ways = np.array(velocity.noise_std_m_s), ("velocity ahead", "velocity to the left")
        add("velocity", velocity, velocity.v_m_s, ways, "m/s", std)
    if (sonar := flight.sonar) is not None:
        add("sonar", sonar, sonar.range_m[:, None], ["range"], "m", np.array([sonar.noise_std_m]))
    return found
