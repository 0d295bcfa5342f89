"""Derivatives of the inertial comparisons: how each error of an instrument, and each lag, changes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.data_quality.inertial_comparison import (
    INTEGRATED,
    READ_AS,
    ImuReadings,
    IntegralComparison,
    compared,
    imu_of,
    in_body_axes,
)
from slam.data_quality.lag import PROMPT, Lag
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

SMALL = 0.2
"""Size at which a term is undone for its derivative, as a share of its usual range."""
DELAY, SMOOTHING = ".delay_s", " smoothed"
"""Suffixes of the columns of a stream that lags: by the mean of the age of what is read, and its variance."""
STEP_S = 0.02
"""Step of a delay for its derivative: one of some milliseconds would show the noise between two samples."""
FILTER_S = 0.08
"""Time constant of a low-pass filter for the derivative by the variance."""
LAGGING = "attitude", "velocity"
"""Streams whose lag is no term, in the order in which it is sought."""
ROUNDING = 1e-9
"""Greatest entry of a column that is rounding."""


def derivatives(flight: Flight, imu: ImuReadings, kind: str, off: Array) -> dict[str, Array]:
    """Return column -> (n, components) the change of the differences with each parameter of the terms, and
    with each lag.

    The catalogue's own corrections say how an error acts: the differences are compared with the term undone
    at a small size of either sign. A scale has two columns: by the quantity as read, and as integrated.
    """
    traces: dict[str, Array] = {}
    for term in CATALOGUE.values():
        if term.undo is None or not term.in_differences or term.stream not in ("imu", READ_AS[kind]):
            continue
        for k, parameter in enumerate(term.smooth):
            size = SMALL * (parameter.high - parameter.low)
            values = np.array([[p.neutral for p in term.parameters]] * 2)
            values[:, k] += -size, size
            sides = []
            for undone in (term.undo(flight, v, None) for v in values):
                changed = imu
                if term.stream == "imu":
                    gyro, accel = in_body_axes(undone).values()
                    changed = replace(imu, gyro=gyro, accel=accel)
                sides.append(compared(undone, changed, kind).off)
            column = (sides[0] - sides[1]) / (2.0 * size)
            if np.abs(column).max() < ROUNDING:
                continue
            name = f"{term.name}.{parameter.name}"
            traces[name] = column
            if term.scales:
                other = column - off
                by_read, by_integral = (other, column) if term.stream == "imu" else (column, other)
                traces[name], traces[name + INTEGRATED] = by_read, by_integral
    return traces | _lag_traces(flight, imu, kind)


def usual_size(column: str) -> float:
    """Return the greatest usual size of an error, half the range of its term's parameter."""
    name = column.removesuffix(INTEGRATED)
    term, _, parameter = name.partition(".")
    if term in CATALOGUE:
        usual = CATALOGUE[term].parameter(parameter)
        return 0.5 * (usual.high - usual.low)
    return FILTER_S**2 if name.endswith(SMOOTHING) else FILTER_S


def _lag_traces(flight: Flight, imu: ImuReadings, kind: str) -> dict[str, Array]:
    """Return column -> (n, components) the change of the differences with the lag of each stream."""
    traces = {}
    for stream in LAGGING:
        now = imu.lags.get(stream, PROMPT)
        filtered = Lag(now.delay_s - FILTER_S, FILTER_S)
        sooner, later = (Lag(now.delay_s + side_s) for side_s in (-STEP_S, STEP_S))
        for suffix, one, other, size in (
            (DELAY, sooner, later, 2.0 * STEP_S),
            (SMOOTHING, now, filtered, FILTER_S**2),
        ):
            each = (with_lags(flight, {**imu.lags, stream: lag}, kind).off for lag in (one, other))
            column = np.subtract(*each) / size
            if np.abs(column).max() < ROUNDING:
                continue
            traces[stream + suffix] = column
            if suffix == SMOOTHING and stream == kind:
                # The integral's own noise is in what a filter would take from it: it would look like one.
                seen = with_lags(flight, imu.lags, kind)
                by_read = (Lag(-FILTER_S, FILTER_S).of(seen.stamps_s, seen.read) - seen.read) / size
                traces |= {stream + suffix: by_read, stream + suffix + INTEGRATED: column}
    return traces


def with_lags(flight: Flight, lags: Mapping[str, Lag], kind: str) -> IntegralComparison:
    """Return the comparison of a kind that the flight's streams allow, with the lags of some streams."""
    imu = imu_of(flight, lags)
    assert imu is not None
    return compared(flight, imu, kind)
