"""Quality of recorded readings, whatever the vehicle: frozen and rounded streams, and spectral lines."""

from __future__ import annotations

from slam.data_quality.anomalies import StreamAnomaly, stream_anomalies

__all__ = ["StreamAnomaly", "stream_anomalies"]
