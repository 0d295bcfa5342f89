"""Terms of the sonar. Symbols: z the height above the surface below, theta and phi the tilt, r the
reading. Terms are in the order in which they act on a reading: corrections have the opposite order. They give
ranges of a pencil beam with exact scale and zero.
"""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import Any

import numpy as np

from slam.core.flight import Flight
from slam.core.rotations import up_at
from slam.core.streams import Sonar
from slam.simulation.terms.term import BODY_AXES, Array, Parameter, Term, signed, size

ASSUMED_DEG_C = 20.0
"""Air temperature that the sonar assumes."""
SOUND_M_S_K = 0.606
"""Change of the speed of sound per kelvin, in m/s."""
ASSUMED_SOUND_M_S = 331.3 + SOUND_M_S_K * ASSUMED_DEG_C


def _warmed(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    out[0] *= ASSUMED_SOUND_M_S / (ASSUMED_SOUND_M_S + SOUND_M_S_K * values[first] * elapsed)


def _scaled(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    out[0] *= 1.0 + values[first]


def _shifted(out: Any, state: Any, rate: Any, elapsed: Any, values: Any, first: int) -> None:
    out[0] += values[first]


def _without_slant(flight: Flight, values: Array, std: float | None) -> Flight:
    """Convert to ranges of a pencil beam: the back end expects ranges along the beam."""
    sonar = _sonar(flight)
    slant = 1.0 / np.maximum(up_at(flight.attitude, sonar.stamps_s)[:, 2], 0.1)
    range_m = sonar.range_m * slant / (1.0 + values[0] * (slant - 1.0))
    return replace(flight, sonar=replace(sonar, range_m=range_m))


def _without_tilt(flight: Flight, values: Array, std: float | None) -> Flight:
    """Set the mount to the true direction of the beam."""
    from scipy.spatial.transform import Rotation

    sonar, turn = _sonar(flight), np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([*values, 0.0]).as_matrix()
    b_T_s = turn @ sonar.b_T_s
    b_T_s[:3, 3] = sonar.b_T_s[:3, 3]
    return replace(flight, sonar=replace(sonar, b_T_s=b_T_s))


def _without_warming(flight: Flight, values: Array, std: float | None) -> Flight:
    """Undo the change of the speed of sound in air that warms up over the flight."""
    sonar = _sonar(flight)
    progress = (sonar.stamps_s - sonar.stamps_s[0]) / max(float(np.ptp(sonar.stamps_s)), 1e-9)
    ratio = (ASSUMED_SOUND_M_S + SOUND_M_S_K * values[0] * progress) / ASSUMED_SOUND_M_S
    return replace(flight, sonar=replace(sonar, range_m=sonar.range_m * ratio))


def _without_scale(flight: Flight, values: Array, std: float | None) -> Flight:
    """Divide ranges, their noise and their limits."""
    sonar, by = _sonar(flight), 1.0 + values[0]
    divided = replace(
        sonar,
        range_m=sonar.range_m / by,
        noise_std_m=sonar.noise_std_m / by,
        min_range_m=sonar.min_range_m / by,
        max_range_m=sonar.max_range_m / by,
        scale_std=sonar.scale_std if std is None else std,
    )
    return replace(flight, sonar=divided)


def _without_bias(flight: Flight, values: Array, std: float | None) -> Flight:
    """Shift readings and limits back, so that valid readings stay valid."""
    sonar, by_m = _sonar(flight), float(values[0])
    shifted = replace(
        sonar,
        range_m=sonar.range_m - by_m,
        min_range_m=max(0.0, sonar.min_range_m - by_m),
        max_range_m=sonar.max_range_m - by_m,
        datum_std_m=sonar.datum_std_m if std is None else std,
    )
    return replace(flight, sonar=shifted)


def _with_rounding_noise(flight: Flight, values: Array, std: float | None) -> Flight:
    """Add the rounding to the noise; the rounding itself cannot be undone."""
    sonar = _sonar(flight)
    noise_std_m = float(np.hypot(sonar.noise_std_m, values[0] / np.sqrt(12.0)))
    return replace(flight, sonar=replace(sonar, noise_std_m=noise_std_m))


def _without_dead_zone(flight: Flight, values: Array, std: float | None) -> Flight:
    """Remove ranges at the limit of the dead zone, within the noise; the true range may be any below."""
    sonar = _sonar(flight)
    stuck = sonar.range_m <= values[0] + sonar.noise_std_m
    return replace(flight, sonar=replace(sonar, range_m=np.where(stuck, np.nan, sonar.range_m)))


def _without_lag(flight: Flight, values: Array, std: float | None) -> Flight:
    """Move stamps: a range stamped t was measured at t - T."""
    return flight.restamped(("sonar",), lambda stamps_s: stamps_s - values[0])


def _sonar(flight: Flight) -> Sonar:
    assert flight.sonar is not None
    return flight.sonar


SONAR = (
    Term(
        name="sonar_slant",
        title="a sonar range that depends on tilt",
        meaning="the sonar's range depends on the tilt in another way",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(
            Parameter(
                name="c",
                unit="1",
                neutral=1.0,
                low=0.0,
                high=1.0,
                least=-1.0,
                most=2.0,
                step=0.01,
                quantity="share of the tilt's effect",
            ),
        ),
        equation=(
            "r = z (1 + c (1 / (cos theta cos phi) - 1)): 1 is a pencil beam, 0 the first echo of a wide one"
        ),
        confounders=("sonar_scale", "sonar_temperature"),
        excitation="tilts of 10 to 20 deg",
        tolerance=0.03,
        in_differences=True,
        stream="sonar",
        undo=_without_slant,
    ),
    Term(
        name="sonar_tilt",
        title="a sonar mounted at an angle",
        meaning="the sonar is mounted at an angle",
        family="sonar",
        acts_on="sensor",
        instrument="mounting of the height sensor",
        parameters=(
            signed("x", "rad", radians(5), 0.5, step=0.001, quantity=BODY_AXES["x"]),
            signed("y", "rad", radians(5), 0.5, step=0.001, quantity=BODY_AXES["y"]),
        ),
        equation=(
            "the beam is rotated about the body's x and y by these angles: to first order r += z (x tan phi"
            " + y tan theta)"
        ),
        confounders=("floor_slope",),
        excitation="the same track in both directions",
        tolerance=0.003,
        in_differences=True,
        stream="sonar",
        undo=_without_tilt,
    ),
    Term(
        name="sonar_temperature",
        title="a sonar that drifts in warming air",
        meaning="the sonar's scale drifts as the air warms",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(signed("rise", "K", 15.0, 60.0, step=0.1, quantity="warming"),),
        equation=(
            "r c(20) / c(T), c = 331.3 + 0.606 T, T rises from 20 degrees Celsius by this much over the "
            "flight"
        ),
        confounders=("sonar_scale", "battery_sag"),
        excitation="a flight with the temperature logged",
        stream="sonar",
        read=_warmed,
        undo=_without_warming,
    ),
    Term(
        name="sonar_scale",
        title="a sonar wrong by a factor",
        meaning="the sonar reads too far or too near by a factor",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(signed("eps", "1", 0.05, 0.5, step=0.001, quantity="error of the range"),),
        equation="r (1 + eps)",
        confounders=("sonar_bias", "sonar_temperature"),
        excitation="two heights",
        tolerance=0.003,
        in_differences=True,
        stream="sonar",
        read=_scaled,
        undo=_without_scale,
        scales=True,
    ),
    Term(
        name="sonar_bias",
        title="a sonar bias",
        meaning="the sonar reads too far or too near by a fixed length",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(signed("b", "m", 0.05, 1.0, step=0.001, quantity="error of the range"),),
        equation="r + b",
        confounders=("sonar_scale",),
        excitation="a touchdown; the floor's datum has the same effect",
        tolerance=0.01,
        stream="sonar",
        read=_shifted,
        undo=_without_bias,
    ),
    Term(
        name="sonar_spikes",
        title="second echoes of the sonar",
        meaning="the sonar sometimes reads the second echo",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(size("share", "1", 0.001, 0.05, 0.5, quantity="share of the readings"),),
        equation="this share of the readings is the second echo, near 2 r",
        confounders=("floor_steps",),
        excitation="a second flight over the track: spikes do not repeat",
        in_single_readings=True,
    ),
    Term(
        name="sonar_quantisation",
        title="a sonar that reads in steps",
        meaning="the sonar reads in steps",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(size("step", "m", 0.01, 0.05, 1.0, quantity="step"),),
        equation="r is rounded to multiples of the step",
        confounders=(),
        excitation="a slow climb",
        in_single_readings=True,
        stream="sonar",
        undo=_with_rounding_noise,
    ),
    Term(
        name="sonar_dead_zone",
        title="a sonar stuck near the floor",
        meaning="the sonar is stuck near the floor",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(size("limit", "m", 0.25, 0.4, 2.0, quantity="height at which it sticks"),),
        equation="below the limit r stays at the limit",
        confounders=("ground_effect",),
        excitation="a slow descent",
        in_single_readings=True,
        stream="sonar",
        undo=_without_dead_zone,
    ),
    Term(
        name="sonar_lag",
        title="a late sonar",
        meaning="the sonar reads with a delay",
        family="sonar",
        acts_on="sensor",
        instrument="height sensor",
        parameters=(size("T", "s", 0.04, 0.15, 2.0, step=0.001, quantity="delay"),),
        equation="r(t - T)",
        confounders=("climb_asymmetry",),
        excitation="steps up and down",
        tolerance=0.003,
        in_differences=True,
        stream="sonar",
        undo=_without_lag,
    ),
)
