"""Nuisances: quantities that differ between healthy vehicles.

Some change the mean of the readings (gain, drag, attitude time, the sonar's zero). The others change only the
process noise and the noise of instruments. Each is a number x with a healthy range; the second sort are
logarithms of factors on the model's own figure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.perturbations import Perturbation, parameter_perturbation
from slam.criticism.kalman.readings import INSTRUMENT_CHANNELS, INSTRUMENTS
from slam.criticism.kalman.transition import HOLD
from slam.criticism.search.information import gain_column

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """A parameter that is fitted, and never reported as a cause while it stays in its range."""

    name: str
    unit: str
    kind: Literal["mean", "hold", "noise", "ar1", "gain"]
    entry: tuple[int, ...]
    """Entry of ``transition.HOLD``, of the channels or of the instruments; unused for nuisances of the
    mean."""
    reach: float
    """Half the healthy range, about the model's own value; for noise that of the logarithm."""
    relative: bool = False
    """Whether the reach is a share of the model's own value."""
    step: float = 0.02


FIFTH = 0.225
"""Reach of a factor of 20 % either way: a logarithm reaches further down than up."""
MAX_AR1 = 0.95


def _mean(name: str, unit: str, reach: float, relative: bool, step: float) -> Nuisance:
    return Nuisance(name, unit, "mean", (), reach, relative, step)


def _hold(name: str, unit: str, reach: float) -> Nuisance:
    return Nuisance(name, unit, "hold", (HOLD.index(name),), reach)


NUISANCES = (
    _mean("vehicle.gain", "1", reach=0.05, relative=True, step=1e-3),
    _mean("vehicle.drag_1_s", "1/s", reach=0.10, relative=True, step=1e-3),
    _mean("vehicle.attitude_time_s", "s", reach=0.10, relative=True, step=1e-4),
    _mean("sonar.datum_m", "m", reach=0.01, relative=False, step=1e-3),
    _hold("tilt_std_rad", "rad", FIFTH),
    _hold("tilt_time_s", "s", 0.5),
    _hold("yaw_rate_std_rad_s", "rad/s", FIFTH),
    _hold("yaw_rate_time_s", "s", 0.56),
    _hold("velocity_std_m_s", "m/s", FIFTH),
    _hold("velocity_time_s", "s", 0.85),
    _hold("velocity_up_std_m_s", "m/s", FIFTH),
    *(
        Nuisance(name=f"{name}_noise", unit="1", kind="noise", entry=tuple(channels), reach=0.2)
        for name, channels in zip(INSTRUMENTS, INSTRUMENT_CHANNELS, strict=True)
    ),
)
AR1_COEFFICIENTS = tuple(
    Nuisance(name=f"{name}_ar1", unit="1", kind="ar1", entry=(k,), reach=MAX_AR1)
    for k, name in enumerate(INSTRUMENTS)
)
"""AR(1) coefficients of the instruments, which are fitted only where noise is not white."""
TAILS = 0.16
OUT_OF_MODEL_NOISE = 4.0
"""Upward reach of the logarithms where a vehicle's instruments are not the model's: a factor of 50."""
MEAN_NUISANCES = tuple(n for n in NUISANCES if n.kind == "mean")
NOISE_NUISANCES = tuple(n for n in NUISANCES if n.kind != "mean")
GAIN_CORRECTED = tuple(n.name for n in NOISE_NUISANCES)
GAIN_NUISANCES = tuple(
    Nuisance(name=gain_column(name), unit="1", kind="gain", entry=(), reach=TAILS) for name in GAIN_CORRECTED
)
"""Errors of the filter's gains. One Gaussian standard deviation cannot give both the scatter and the best
gain of noise with heavy tails. A wrong gain leaves residuals that resemble a target proportional to tilt."""


def perturbation_of(nuisance: Nuisance) -> Perturbation:
    """Return the perturbation of a nuisance of the mean."""
    return parameter_perturbation(nuisance.name, nuisance.step)


MEAN_PERTURBATIONS = tuple(perturbation_of(n) for n in MEAN_NUISANCES)


def value_of(nuisance: Nuisance, parameters: FilterParameters) -> float:
    """Return x in filter parameters."""
    if nuisance.kind == "gain":
        return 0.0
    where, entries = _entries(nuisance)
    value = float(getattr(parameters, where)[entries[0]])
    return float(np.log(value)) if nuisance.kind in _LOGARITHMS else value


def with_value(nuisance: Nuisance, parameters: FilterParameters, x: float) -> FilterParameters:
    """Return filter parameters with another x. They do not hold the errors of the gains."""
    if nuisance.kind == "gain":
        return parameters
    if nuisance.kind == "ar1":
        x = min(max(x, 0.0), MAX_AR1)
    where, entries = _entries(nuisance)
    vector = getattr(parameters, where).copy()
    vector[entries] = np.exp(x) if nuisance.kind in _LOGARITHMS else x
    return replace(parameters, **{where: vector})


_LOGARITHMS = ("hold", "noise")
"""Kinds whose x is the logarithm of the entry."""


def _entries(nuisance: Nuisance) -> tuple[str, list[int]]:
    """Return the vector of the filter parameters that holds a nuisance, and its entries there."""
    if nuisance.kind == "mean":
        perturbation = perturbation_of(nuisance)
        return "dynamics" if perturbation.kind == "dynamics" else "sensor", [perturbation.entry]
    vectors = {"hold": "hold", "noise": "noise_factor", "ar1": "noise_correlation"}
    return vectors[nuisance.kind], list(nuisance.entry)


def limits_of(nuisance: Nuisance, model: FilterParameters) -> tuple[float, float]:
    """Return the healthy range of x about a model's own value."""
    centre = value_of(nuisance, model)
    reach = nuisance.reach * abs(centre) if nuisance.relative else nuisance.reach
    # Noise with heavy tails looks smaller than it is once its outliers are cut.
    tails = TAILS if nuisance.kind == "noise" else 0.0
    if model.out_of_model and nuisance.kind == "noise":
        # No reading of an out-of-model vehicle is judged finer than the model's own instruments.
        return centre - reach - tails, centre + OUT_OF_MODEL_NOISE
    return centre - reach - tails, centre + reach


def prior_precision(nuisance: Nuisance, model: FilterParameters) -> float:
    """Return the reciprocal of the variance of a uniform prior over the healthy range."""
    low, high = limits_of(nuisance, model)
    return 12.0 / (high - low) ** 2
