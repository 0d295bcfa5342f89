"""Quality of recorded readings, whatever the vehicle.

Streams may be dead, frozen, rounded or oscillating, and their axes exchanged. Stamps may be uneven, commands
on another clock and pictures lost. Pictures may show more than the floor, and ranges boxes that stand on it.
"""

from __future__ import annotations

from slam.data_quality.anomalies import (
    readings_in_words,
    stream_anomalies,
    without_frozen,
)
from slam.data_quality.axes import axes_of_all
from slam.data_quality.channels import misstated_noise, with_scattering_noise
from slam.data_quality.dead_streams import without_dead_streams
from slam.data_quality.finding import Finding
from slam.data_quality.jumps import jumps_of_all

__all__ = [
    "Finding",
    "axes_of_all",
    "jumps_of_all",
    "misstated_noise",
    "readings_in_words",
    "stream_anomalies",
    "with_scattering_noise",
    "without_dead_streams",
    "without_frozen",
]
