"""Poses for evaluation tools: TUM lines and the truth of EuRoC, with evo as an oracle."""

from __future__ import annotations

import numpy as np
import pytest

from slam.io.exports.formats import export_map
from slam.io.flight_folder import read_flight
from tests.slam.io.exports.made_map import FIRST_NS, exported, made_map, pose

file_interface = pytest.importorskip("evo.tools.file_interface")

HALF = np.sqrt(0.5)


@pytest.mark.parametrize("known", ["tum", "euroc"])
def test_evo_reads_the_poses(known, tmp_path):
    """A body with its nose to the north is turned by 90 degrees about up: w = z = sqrt(1/2)."""
    target = tmp_path / "poses"
    export_map(exported(made_map(pose((1.5, -2.0, 10.0)), pose((3.0, 4.0, 11.0)))), known, target)
    readers = {
        "tum": file_interface.read_tum_trajectory_file,
        "euroc": file_interface.read_euroc_csv_trajectory,
    }
    found = readers[known](target)
    np.testing.assert_allclose(found.positions_xyz, [[1.5, -2, 10], [3, 4, 11]], atol=1e-9)
    np.testing.assert_allclose(found.orientations_quat_wxyz, [[HALF, 0, 0, HALF]] * 2, atol=1e-9)
    np.testing.assert_allclose(found.timestamps, FIRST_NS / 1e9 + np.arange(2), atol=1e-6)
    assert found.check()[0]


def test_stamps_keep_their_nanoseconds(tmp_path):
    export_map(exported(made_map(pose(), epoch_ns=1_714_979_289_123_456_789)), "euroc", tmp_path / "e")
    export_map(exported(made_map(pose(), epoch_ns=1_714_979_289_123_456_789)), "tum", tmp_path / "t")
    assert (tmp_path / "e").read_text().splitlines()[1].startswith("1714979289123456789,")
    assert (tmp_path / "t").read_text().splitlines()[1].startswith("1714979289.123456789 ")


def test_the_truth_fits_into_a_flight_folder(tmp_path):
    truth = tmp_path / "flight" / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir(parents=True)
    export_map(exported(made_map(pose(), pose((3.0, 4.0, 11.0)))), "euroc", truth / "data.csv")
    (truth / "sensor.yaml").write_text("sensor_type: visual-inertial\n")
    (tmp_path / "flight" / "flight.yaml").write_text("name: made\n")
    flight = read_flight(tmp_path / "flight")
    assert flight.truth is not None
    np.testing.assert_allclose(flight.truth.w_T_b, [pose(), pose((3.0, 4.0, 11.0))], atol=1e-9)
