"""The machine-readable result of ``slam estimate``: its ``summary.json``."""

from __future__ import annotations

from typing import Any

from slam.core.summary import summarise
from slam.inertial.navigate import Navigation


def summary_record(navigation: Navigation) -> dict[str, Any]:
    """Return the keys of every summary and the consistency of each channel.

    A channel has the number of ``readings`` and, of these, ``believed`` ones with full weight. Their mean
    squared whitened innovation is ``nis`` (1 expected). ``delay_s`` and ``noise_factor`` are those
    identified.
    """
    adjustments = navigation.inputs.adjustments
    channels = {}
    for name, channel in navigation.track.channels.items():
        channels[name] = {
            "readings": len(channel.stamps_s),
            "believed": int(channel.accepted.any(axis=1).sum()),
            "nis": channel.mean_nis,
            "delay_s": float(adjustments.delay_s.get(name, 0.0)),
            "noise_factor": float(adjustments.noise_factor.get(name, 1.0)),
        }
    return {**summarise(navigation.estimate).to_json(), "channels": channels}
