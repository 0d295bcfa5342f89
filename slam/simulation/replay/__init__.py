"""Replay: simulation of the commands of a measured flight, compared with its readings channel by channel.

The model flies open loop and without noise, from states estimated from the measurements. One roll-out covers
the whole flight, and many short ones begin along it. The difference after 0.5, 2 and 10 s is the error of the
model in physical units.
"""

from __future__ import annotations

from slam.simulation.replay.compare import HORIZONS_S, Comparison, Replay, replay

__all__ = ["HORIZONS_S", "Comparison", "Replay", "replay"]
