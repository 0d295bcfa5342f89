"""All readings of a flight and all requested times, sorted by time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.ekf import readings as kinds
from backend.ekf.inputs import READINGS, CloneMode, Readings, Series, VisualStep
from backend.ekf.records import FilterEvents
from backend.errors import BackendError
from backend.whitening import whitening

Array = NDArray[np.float64]

_MAX_STEP_S = 0.05
"""Largest time step of the propagation through gaps."""
_MOST_STEPS = 1200
"""Most steps through one gap, a minute of them. Longer gaps take longer steps: the mean of the rate, which
the steps are for, has faded by then."""
_WIDTH = 3
"""Number of components of the widest reading."""


def sort_events(readings: Readings, at_s: Array, clone: CloneMode) -> FilterEvents:
    """Sort finite readings, requested times, and propagation steps through gaps by time.

    At one instant readings come first, then the pose is recorded, then cloned (``clone``). Raises
    ``BackendError`` for times that do not increase or a step that does not join neighbours.
    """
    if not np.isfinite(at_s).all() or (np.diff(at_s) <= 0).any():
        raise BackendError("the requested times do not increase; sort them")
    for step in readings.steps:
        if step.j != step.i + 1 or not 0 <= step.i < len(at_s) - 1:
            raise BackendError(f"a step joins {step.i} and {step.j} of {len(at_s)}; steps join neighbours")
    series = {name: getattr(readings, field) for name, field in READINGS.items()}
    parts = [_from_series(kinds.CHANNELS[name], each) for name, each in series.items() if each is not None]
    reached_s = at_s[[step.j for step in readings.steps]] if readings.steps else np.zeros(0)
    parts += [_without_values(kinds.STEP, reached_s), _without_values(kinds.OUTPUT, at_s)]
    clone_s = {"none": at_s[:0], "first": at_s[:1], "each": at_s}[clone]
    parts.append(_without_values(kinds.CLONE, clone_s))
    parts.append(
        _without_values(kinds.PROPAGATE, _gap_times(np.concatenate([stamps for stamps, *_ in parts])))
    )
    stamps_s, kind, value, std, row = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((kind, stamps_s))
    return FilterEvents(
        stamps_s=stamps_s[order],
        kind=kind[order],
        value=value[order],
        std=std[order],
        row=row[order],
        step=np.array([step.i_T_j for step in readings.steps], dtype=float).reshape(-1, 4, 4),
        step_whitener=_whiteners(readings.steps),
    )


_Part = tuple[Array, NDArray[np.int64], Array, Array, NDArray[np.int64]]
"""Stamps, kinds, values, stds, rows."""


def _from_series(kind: int, readings: Series) -> _Part:
    usable = np.isfinite(readings.stamps_s) & np.isfinite(readings.values).any(axis=1)
    stamps_s, kinds_, value, std, row = _without_values(kind, readings.stamps_s[usable])
    width = readings.values.shape[1]
    value[:, :width] = readings.values[usable]
    std[:, :width] = np.broadcast_to(readings.std, readings.values.shape)[usable]
    if not (std[:, :width] > 0).all():
        raise BackendError("a reading has a standard deviation that is not above zero; correct the noise")
    return stamps_s, kinds_, value, std, row


def _without_values(kind: int, stamps_s: Array) -> _Part:
    count = len(stamps_s)
    nothing = np.full((2, count, _WIDTH), np.nan)
    return stamps_s, np.full(count, kind), nothing[0], nothing[1], np.arange(count)


def _gap_times(stamps_s: Array) -> Array:
    """Return times inside gaps between stamps, at most the largest step apart in all but very long ones."""
    known = np.unique(stamps_s)
    lengths_s = np.diff(known)
    gaps = np.flatnonzero(lengths_s > _MAX_STEP_S)
    steps = np.minimum(np.ceil(lengths_s[gaps] / _MAX_STEP_S), _MOST_STEPS).astype(int)
    between = [
        np.linspace(known[g], known[g + 1], count + 1)
        for g, count in zip(gaps.tolist(), steps.tolist(), strict=True)
    ]
    return np.concatenate([inner[1:-1] for inner in between]) if between else np.zeros(0)


def _whiteners(steps: tuple[VisualStep, ...]) -> Array:
    """Return (s, 6, 6) inverse Cholesky factors of the steps' covariances. Raises ``BackendError``."""
    covariance = np.array([step.covariance for step in steps], dtype=float).reshape(-1, 6, 6)
    try:
        return whitening(covariance)
    except np.linalg.LinAlgError:
        raise BackendError("a step's covariance is not positive definite; drop that step") from None
