"""Replay: the commands of a measured flight given to a model, and both compared channel by channel.

The model is flown open loop, without noise, from states estimated from the measurements themselves: once over
the whole flight, and in roll-outs of some horizon that begin again and again along it. How far the two are
apart after half a second, two and ten is what the model gets wrong, in physical units.
"""

from __future__ import annotations

from slam.simulation.replay.compare import HORIZONS_S, Comparison, Replay, replay

__all__ = ["HORIZONS_S", "Comparison", "Replay", "replay"]
