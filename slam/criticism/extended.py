"""Extended model: the nominal model with nuisances fitted and causes added."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from slam.core.arrays import Array
from slam.criticism.cause import WIDE, Cause
from slam.criticism.kalman.filter_parameters import (
    HOLD_NOISES,
    NOISE_CORRELATIONS,
    NOISE_FIGURES,
    FilterParameters,
    filter_parameters_of,
)
from slam.criticism.kalman.readings import DATUM, IMU, INSTRUMENT_CHANNELS, place_of
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.transition import GUST_STD, GUST_TIME
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.simulation.dynamics import ATTITUDE_TIME, DRAG, GAIN
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

_EXTENDED = " extended"
"""Suffix of the extended model's name. A name has at most 80 letters."""
NOT_HELD = "exposure_variation", "tau"
"""Term and parameter that no filter parameters hold."""


def with_terms(model: Model, found: Iterable[Cause]) -> Model:
    """Return the model with the terms that were found, at their sizes."""
    for one in found:
        model = model.with_sizes(one.name, {n: p.value for n, p in one.parameters.items()})
    return model


def extended_model(
    model: Model, parameters: FilterParameters, causes: Sequence[str], records: Sequence[Record]
) -> Model:
    """Return the model of some fitted filter parameters, with terms of ``causes`` alone, within limits."""
    names = (
        "vehicle.gain", "vehicle.drag_1_s", "vehicle.attitude_time_s", "sonar.datum_m",
        *HOLD_NOISES, *NOISE_CORRELATIONS, *NOISE_FIGURES,
    )  # fmt: skip
    values = (
        *parameters.dynamics[[GAIN, DRAG, ATTITUDE_TIME]], parameters.sensor[DATUM],
        *parameters.hold[: len(HOLD_NOISES)], *parameters.noise_correlation,
        *_noise(model, parameters, records),
    )  # fmt: skip
    name = f"{model.name.removesuffix(_EXTENDED)[: 80 - len(_EXTENDED)]}{_EXTENDED}"
    plain = replace(model.with_figures(names, values), name=name)
    return reduce(lambda known, name: _with(known, name, parameters), causes, plain)


def _noise(model: Model, parameters: FilterParameters, records: Sequence[Record]) -> Array:
    """Return the noise of each of ``INSTRUMENTS`` (of the imu its density), as fitted to the flights.

    The model's own figure stands where no flight has the instrument, and for an out-of-model vehicle: there
    the parameters state the trust in readings, not their scatter.
    """
    own = model.figures(NOISE_FIGURES)
    if parameters.out_of_model:
        return own
    for k, channels in enumerate(INSTRUMENT_CHANNELS):
        kind, _ = place_of(channels[0])
        reported = []
        for record in (r for r in records if r.has(channels[0])):
            step_s = float(np.median(np.diff(record.times_s[record.kinds == kind]))) if kind == IMU else 1.0
            reported.append(record.noise_std[channels[0]] * np.sqrt(step_s))
        if reported:
            own[k] = float(np.median(reported) * parameters.noise_factor[channels[0]])
    return own


def with_certainty(model: Model, causes: Sequence[Cause]) -> Model:
    """Return the model with the standard deviations from the causes' intervals."""
    for cause in causes:
        current = model.terms.get(cause.name, {})
        std = {n: 0.5 * (p.high - p.low) / WIDE for n, p in cause.parameters.items() if n in current}
        known = {n: float(s) for n, s in std.items() if np.isfinite(s) and s > 0.0}
        model = model.with_std(cause.name, **known) if known else model
    return model


def _with(model: Model, name: str, parameters: FilterParameters) -> Model:
    """Return the model with a term as the filter parameters hold it."""
    own_fields = {
        "timestamp_jitter": {"sigma": parameters.jitter_s},
        "gusts": {"sigma": float(parameters.hold[GUST_STD]), "tau": float(parameters.hold[GUST_TIME])},
        "attitude_lag": {"tau": float(parameters.dynamics[ATTITUDE_TIME])},
    }
    if name in own_fields:
        return model.with_sizes(name, own_fields[name])
    values, before = {}, filter_parameters_of(model)
    for parameter in (p for p in CATALOGUE[name].parameters if (name, p.name) != NOT_HELD):
        fitted = fitted_parameter(f"{name}.{parameter.name}")
        if (x := fitted.value_in(parameters)) != fitted.value_in(before):
            values[parameter.name] = fitted.in_catalogue_units(x - parameter.neutral, parameters)
    return model.with_sizes(name, values) if values else model
