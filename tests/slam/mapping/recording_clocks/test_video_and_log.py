"""A video and a log of one measured flight, given together to ``slam import``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.flight_folder import read_flight
from tests.slam.io.recordings.logs.made_ulog import log
from tests.slam.mapping.recording_clocks.made_sources import IMU, imu_rows, video_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set"),
]
FIRST, COUNT, RATE_HZ = 150, 800, 15.0


def test_a_video_that_begins_in_the_log_is_aligned_to_five_milliseconds(tmp_path):
    flight = read_flight(Path(os.environ["SLAM_DATA"]) / "flights" / "ardrone2-hybrid")
    begin_s = video_of(flight, tmp_path / "video.mp4", FIRST, COUNT, RATE_HZ)
    rows, first_s = imu_rows(flight, begin_s - 7.3, boot_s=5000.0)
    log(tmp_path / "flight.ulg", {"sensor_combined": (IMU, "6f", rows)})
    out = tmp_path / "joined"
    sources = [str(tmp_path / "video.mp4"), str(tmp_path / "flight.ulg")]
    result = CliRunner().invoke(app, ["import", *sources, "--out", str(out)])
    assert result.exit_code == 0, result.output
    joined = read_flight(out)
    found_s = joined.frames.stamps_s[0] - joined.imu.stamps_s[0]
    assert found_s == pytest.approx(begin_s - first_s, abs=0.005)
    assert np.ptp(joined.frames.stamps_s) == pytest.approx((COUNT - 1) / RATE_HZ, abs=0.005)
