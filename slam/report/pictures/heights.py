"""The picture of the heights of the ground in a report, and the words below it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slam.core.estimate import Estimate, GroundFacts
from slam.core.flight import Flight
from slam.core.units import SPACE, area
from slam.report.coordinates import at
from slam.report.facts import Facts, whence
from slam.report.floor_scatter import FloorScatter, floor_scatter
from slam.report.page import embedded


def heights_figure(path: Path | None) -> str | None:
    """Return the picture as a data address; None without the file."""
    return embedded(path.read_bytes()) if path is not None and path.exists() else None


def heights_figure_words(estimate: Estimate, facts: Facts, flight: Flight | None) -> str:
    """Return what the picture shows: heights of what, above what, by which instrument, and how good."""
    ground = estimate.ground
    if ground is None or not ground.is_measured:
        return (
            "Height of what stands on the ground, over the floor, which the map takes as flat. The height "
            "sensor alone measured it, and shows no detail smaller than the spot of its beam on the floor. "
            f"{_of_echoes(estimate, facts, flight)}Grey: no echo came from there. "
        )
    known = f", typically to ±{SPACE}{facts.error(ground.height_std_m)}" if ground.height_std_m else ""
    untrusted = (
        f" Pale, where no height is to be trusted: of all ground, {ground.untrusted}."
        if ground.is_measured_in_part
        else ""
    )
    doubted = _doubted(ground, facts, estimate)
    doubtful = " (doubted)" if ground.doubted_at_m and ground.doubted_at_m[2] <= ground.lowest_m else ""
    return (
        "Height of the ground, with what stands on it such as trees, over the floor, which is the level "
        "plane that fits the ground best: from "
        f"{_signed(ground.lowest_m, facts)}{doubtful} to {_signed(ground.highest_m, facts)}, measured by "
        f"what the pictures show from different sides{known}.{untrusted}{doubted}"
        " Grey: no picture shows it. The colours span 99 % of the heights; where the bar ends in a point, a "
        "few lie beyond. "
    )


def _doubted(ground: GroundFacts, facts: Facts, estimate: Estimate) -> str:
    """Return which measured heights are doubted, in sentences with a space in front; empty without any."""
    if ground.doubted_at_m is None:
        return ""
    x, y, height_m = ground.doubted_at_m
    return (
        " Doubted are heights in pits, or strips at the edge of the map, that are deeper than wide: wrong "
        f"matches make them more often than ground does. The lowest is {facts.length(-height_m)} below the "
        "floor, around "
        f"{at(estimate, x, y)}."
    )


def _of_echoes(estimate: Estimate, facts: Facts, flight: Flight | None) -> str:
    """Return how accurate one echo is, and how far those of a flat floor scatter, in sentences with a space
    behind."""
    scatter = None if estimate.elevation is None else floor_scatter(estimate.elevation.height_m)
    text = ""
    if flight is not None and flight.sonar is not None:
        known = facts.error(flight.sonar.noise_std_m)
        text = f"One echo is {whence(flight.sonar)} to be good to ±{SPACE}{known}"
        text += ": smaller differences are noise. " if scatter is None else ". "
    if scatter is not None:
        text += (
            f"Echoes of the floor scatter from {scatter} (three standard deviations to either side, of "
            f"{facts.error(scatter.std_m)} each). Heights "
            "between have the colour of the floor, so that what stands on it can be told. "
        )
        text += _standing_out(estimate, facts, scatter)
    return text


def _standing_out(estimate: Estimate, facts: Facts, scatter: FloorScatter) -> str:
    """Return how much of the measured area lies above and below the floor and where most, in sentences with a
    space behind; empty where nothing does."""
    found = estimate.elevation
    assert found is not None
    lines = []
    for out, index, of_floor in (
        (found.height_m > scatter.highest_m, np.nanargmax(found.height_m), "above"),
        (found.height_m < scatter.lowest_m, np.nanargmin(found.height_m), "below"),
    ):
        if out.any():
            row, column = np.unravel_index(int(index), found.height_m.shape)
            x_m, y_m = found.west_m + (column + 0.5) * found.gsd_m, found.north_m - (row + 0.5) * found.gsd_m
            most_m = abs(float(found.height_m[row, column]))
            lines.append(
                f"{area(float(out.sum()) * found.gsd_m**2, facts.metric)} lie {of_floor} it, by "
                f"{facts.length(most_m)} at most, around {at(estimate, float(x_m), float(y_m))}"
            )
    if not lines:
        return ""
    return f"{'; '.join(lines)}. Single cells, and bars across the path, are likely wrong echoes. "


def _signed(height_m: float, facts: Facts) -> str:
    return f"{facts.length(abs(height_m))} {'below' if height_m < 0 else 'above'} it"
