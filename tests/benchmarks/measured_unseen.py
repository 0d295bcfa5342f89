"""Prediction errors on flights that criticism has not used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from slam.core.flight import Flight
from slam.simulation.model import Model
from slam.simulation.replay import replay

AHEAD_S = 2.0
STILL = 0.25
"""Share of a group's largest error of the same unit below which a channel has no row."""

NOT_SHOWN = ("imu.gyro", "imu.accel", "truth.x", "truth.y", "truth.z")
"""Channels without a row: vibration hides the motion in inertial readings, and positions are sums of the
speeds."""


@dataclass(frozen=True)
class Round:
    """Flights that are judged, and groups of other flights that the resulting model predicts."""

    judged: tuple[str, ...]
    groups: dict[str, tuple[str, ...]]


def unseen_rows(
    rounds: Sequence[Round], models: Sequence[tuple[Model, Model]], opened: Callable[[str], Flight]
) -> list[tuple[str, ...]]:
    """Return rows of group, channel, error of the nominal and of the extended model, and change, pooled over
    rounds and flights."""
    squares: dict[tuple[str, str, str], list[np.ndarray]] = {}
    for one, pair in zip(rounds, models, strict=True):
        for group, paths in one.groups.items():
            for path in paths:
                for key, square in _squares(opened(path), pair).items():
                    squares.setdefault((group, *key), []).append(square)
    # (seconds, and squares times seconds of both models) of each row.
    pooled = {key: np.sum(parts, axis=0) for key, parts in squares.items()}
    error = {key: np.sqrt(total[1:] / total[0]) for key, total in pooled.items()}
    rows = []
    for (group, channel, unit), (before, after) in error.items():
        most = max(e.max() for (g, _, u), e in error.items() if (g, u) == (group, unit))
        if max(before, after) > STILL * most:
            change = f"{100 * (after / before - 1):+.0f} %"
            rows.append((group, f"`{channel}`", f"{before:.3g} {unit}", f"{after:.3g} {unit}", change))
    return rows


def _squares(flight: Flight, pair: tuple[Model, Model]) -> dict[tuple[str, str], np.ndarray]:
    before, after = (replay(flight, model, (AHEAD_S,)) for model in pair)
    span_s = before.end_s - before.begin_s
    found = {}
    for old, new in zip(before.channels, after.channels, strict=True):
        rms = np.array([old.rms[AHEAD_S], new.rms[AHEAD_S]])
        if (
            np.isfinite(rms).all()
            and old.name.rpartition("_")[0] not in NOT_SHOWN
            and old.name not in NOT_SHOWN
        ):
            found[old.name, old.unit] = np.r_[span_s, span_s * rms**2]
    return found
