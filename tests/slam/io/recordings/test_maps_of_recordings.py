"""Maps of one measured flight: from a bag and from its flight folder the same, from a video about as good."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from slam import optimize
from slam.cli.source import open_flight
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.evaluation.trajectory import position_error, umeyama
from slam.io.flight_folder import read_flight, write_flight

DATA = Path(os.environ.get("SLAM_DATA", ""))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set"),
]


def recorded(name: str) -> Flight:
    return open_flight(DATA / "recordings" / name, silent)[0]


def error_m(estimate: Estimate, truth: Flight, begins_s: float) -> float:
    """Return the rms error after a similarity; the first picture is taken at ``begins_s``."""
    at_s = np.asarray(estimate.stamps_s) + begins_s
    true_m = np.stack(
        [np.interp(at_s, truth.truth.stamps_s, truth.truth.w_T_b[:, k, 3]) for k in range(3)], axis=1
    )
    found_m = np.asarray(estimate.w_T_b)[:, :3, 3]
    return position_error(umeyama(found_m, true_m, with_scale=True).apply(found_m), true_m).rmse


def test_the_map_of_a_bag_is_that_of_its_flight_folder_and_a_video_gives_one_about_as_good(tmp_path):
    bag = recorded("ros1-bag/hybrid12s.bag")
    write_flight(bag, tmp_path / "flight", silent)
    from_bag, from_folder = optimize(bag), optimize(read_flight(tmp_path / "flight"))
    assert np.array_equal(from_bag.w_T_b, from_folder.w_T_b)
    assert np.array_equal(from_bag.stamps_s, from_folder.stamps_s)
    truth = read_flight(DATA / "flights" / "ardrone2-hybrid")
    begins_s = (bag.epoch_ns - truth.epoch_ns) * 1e-9
    from_video = optimize(recorded("dji-srt/synthetic_hybrid.MP4"))
    assert error_m(from_video, truth, begins_s) < 2 * error_m(from_folder, truth, begins_s)
