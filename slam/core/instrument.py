"""Properties that the readings of every instrument have."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass


@dataclass(frozen=True)
class Instrument:
    """A series of readings whose noise is known, or assumed."""

    _: KW_ONLY
    noise_assumed: bool = False
    """Whether the standard deviations are assumed, because the recording states none."""
