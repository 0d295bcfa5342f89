"""Consistency of a size over time: a size that varies is no constant error of an instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.criticism.without_commands.effect_columns import in_catalogue, is_square
from slam.criticism.without_commands.regression import TOLERANCE, Regression
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

FEWEST_STRETCHES = 5
BEYOND_CHANCE = 4.0
"""Mean square of the segments' deviations, in variances of white rows, beyond which a size varies."""
TELLING = 0.5
"""Greatest standard error of a segment's size, as a share of the size, for the segment to count."""
LARGE = 0.5
"""Least scatter beyond chance, as a share of the size."""
LEVEL = ("accel_bias.x", "accel_bias.y")
"""Columns along which an attitude error acts like an error of the accelerometer."""


def disagreements(data: Regression, chosen: Sequence[str]) -> list[str]:
    """Describe parameters of the chosen terms that vary between segments by half of themselves."""
    return [
        descriptions
        for effect in chosen
        if effect in CATALOGUE
        for descriptions in _disagreements(data, chosen, effect)
    ]


def varying_sizes(data: Regression, chosen: Sequence[str], effect: str) -> dict[str, Array]:
    """Return column -> (segments,) sizes, of the parameters of a chosen term that vary between segments by
    half of themselves, with all other terms at their common sizes."""
    size, _ = data.fit(chosen)
    own = data.columns_of(chosen, effect)
    rest = np.delete(np.arange(len(size)), own)
    alone = replace(data, off=data.off - data.table(chosen)[:, rest] @ size[rest])
    fits = [alone.fit([effect], data.cluster == k) for k in np.unique(data.cluster)]
    sizes = np.array([fit for fit, _ in fits])
    errors = np.sqrt([np.diag(np.linalg.inv(information)) for _, information in fits])
    varying = {}
    for k, name in enumerate(data.of(effect)):
        if is_square(name):
            continue  # a variance naturally differs from segment to segment
        common = abs(float(size[own[k]]))
        sure = errors[:, k] < TELLING * max(common, TOLERANCE[effect])
        if sure.sum() < FEWEST_STRETCHES:
            continue
        found, chance = sizes[sure, k], float(np.mean(errors[sure, k] ** 2))
        variance = float(np.var(found, ddof=1))
        scatter = float(np.sqrt(max(variance - chance, 0.0)))
        if variance > BEYOND_CHANCE * chance and scatter > LARGE * common:
            varying[name] = found
    return varying


def _disagreements(data: Regression, chosen: Sequence[str], effect: str) -> list[str]:
    """Describe the variation of one term between segments."""
    descriptions = []
    for name, found in varying_sizes(data, chosen, effect).items():
        unit = CATALOGUE[effect].parameter(name.rpartition(".")[2]).unit
        off_deg = float(np.degrees(np.arctan(np.ptp(found) / GRAVITY_M_S2)))
        like = f", like an attitude error of {off_deg:.0f} deg" if name in LEVEL else ""
        least, most = (in_catalogue(name, float(x)) for x in (found.min(), found.max()))
        descriptions.append(f"{name} is {least:.2g} to {most:.2g} {unit} by segments of 10 s{like}")
    return descriptions
