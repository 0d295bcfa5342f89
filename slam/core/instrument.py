"""Properties that the readings of every instrument have."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass


@dataclass(frozen=True)
class Instrument:
    """A series of readings, and which of its accuracies are assumed."""

    _: KW_ONLY
    assumed: tuple[str, ...] = ()
    """Keys of ``sensor.yaml`` whose values are assumed, because the recording does not state them: the noise
    of one reading, ``noise_std``, the errors that all share, ``scale_std`` and ``datum_std``, and for a GPS
    the place of the antenna, ``T_BS``."""

    @property
    def noise_assumed(self) -> bool:
        """Whether the noise of one reading is assumed."""
        return "noise_std" in self.assumed
