"""What ``slam estimate`` came to, for a program to read: its ``summary.json``."""

from __future__ import annotations

from typing import Any

from slam.core.summary import summarise
from slam.inertial.navigate import Navigation


def summary_record(navigation: Navigation) -> dict[str, Any]:
    """The keys of every summary, and beside them how each channel's readings fitted.

    A channel has ``readings``, of these ``believed`` at their full weight with the mean squared whitened
    innovation ``nis`` (1 expected), and ``delay_s`` and ``noise_factor`` as trials found them.
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
