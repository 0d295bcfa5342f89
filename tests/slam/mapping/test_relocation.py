"""Pictures of a second flight, found in the map of the first."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from backend import se3
from frontend.features import FeatureConfig
from slam import Relocalizer, relocalize
from slam.cli import app
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.association import poses_at
from slam.io.estimate import write_estimate
from slam.io.flight_writer import write_flight
from slam.mapping.config import PipelineConfig
from tests.slam.small_flight import elsewhere, flown
from tests.slam.whole_job import normal


@pytest.fixture(scope="module")
def mapped() -> tuple[Flight, Estimate, Relocalizer]:
    flight, estimate = normal()
    return flight, estimate, Relocalizer(estimate, flight)


def world(flight: Flight, estimate: Estimate) -> np.ndarray:
    """The map's coordinates to the simulator's, by the first keyframe."""
    return poses_at(flight.truth, estimate.stamps_s)[0] @ np.linalg.inv(estimate.w_T_b[0])


def test_another_flight_s_pictures_are_found_with_an_honest_covariance(mapped):
    flight, estimate, asked = mapped
    other = flown(7)
    truth = poses_at(other.truth, other.frames.stamps_s)
    to_truth, squared, off_m = world(flight, estimate), [], []
    for k in range(0, len(other.frames), 12):
        location = asked.locate(other.frames.load(k))
        assert location.found, location.reason
        pose = to_truth @ location.w_T_b
        xi = se3.log((np.linalg.inv(pose) @ truth[k])[None])[0]
        squared.append(xi @ np.linalg.solve(location.covariance, xi))
        off_m.append(np.linalg.norm(pose[:3, 3] - truth[k, :3, 3]))
    assert np.sqrt(np.mean(np.square(off_m))) < 0.003
    # All lean on the same map: its error is shared, and counts as a handful of pictures.
    lower, upper = chi2.ppf([0.001, 0.999], 6 * 6) / 6
    assert lower < np.mean(squared) < upper


def test_other_ground_is_not_found(mapped):
    *_, asked = mapped
    other = elsewhere()
    for k in range(0, len(other.frames), 20):
        location = asked.locate(other.frames.load(k))
        assert not location.found
        assert "same ground" in location.reason
        assert np.isnan(location.w_T_b).all()


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros((144, 176), np.uint8), "too few features"),
        (np.zeros((240, 320, 3), np.uint8), "320x240"),
    ],
)
def test_a_picture_without_information_is_reported(mapped, image, reason):
    assert reason in mapped[2].locate(image).reason


@pytest.mark.parametrize(
    ("image", "error"),
    [(None, TypeError), (np.zeros((144, 176)), TypeError), (np.zeros(9, np.uint8), ValueError)],
)
def test_what_is_no_picture_is_refused(mapped, image, error):
    with pytest.raises(error, match=r"^picture: expected an array of uint8"):
        mapped[2].locate(image)


def test_a_flight_that_the_map_was_not_made_of_is_refused(mapped):
    flight, estimate, _ = mapped
    frames = replace(flight.frames, names=tuple(f"x{name}" for name in flight.frames.names))
    renamed = replace(flight, frames=frames)
    with pytest.raises(InputError, match="made of"):
        relocalize(flight.frames.load(0), estimate, renamed)


def test_features_that_opencv_lacks_are_refused(mapped):
    flight, estimate, _ = mapped
    with pytest.raises(InputError, match="surf"):
        Relocalizer(estimate, flight, PipelineConfig(features=FeatureConfig(kind="surf")))


def test_the_command_writes_a_row_a_picture_and_counts_what_it_did_not_find(mapped, tmp_path):
    flight, estimate, asked = mapped
    write_flight(flight, tmp_path / "flight")
    write_estimate(estimate, tmp_path / "map")
    good, strange, broken = (tmp_path / name for name in ("good.png", 'strange ",.png', "broken.png"))
    cv2.imwrite(str(good), flown(7).frames.load(10))
    cv2.imwrite(str(strange), elsewhere().frames.load(10))
    broken.write_bytes(b"no picture")
    folders = {f"--{name}": str(tmp_path / name) for name in ("map", "flight", "out")}
    options = [word for pair in folders.items() for word in pair]
    ran = CliRunner().invoke(app, ["locate", str(good), str(strange), str(broken), *options])
    assert ran.exit_code == 0, ran.output
    with (tmp_path / "out" / "locations.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    expected = asked.locate(cv2.imread(str(good)))
    assert [float(rows[0][key]) for key in ("tx", "ty", "tz")] == pytest.approx(
        expected.w_T_b[:3, 3].tolist(), abs=1e-4
    )
    assert rows[1]["picture"] == str(strange)
    assert "same ground" in rows[1]["reason"]
    assert rows[2]["reason"].startswith("unreadable")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["pictures"], summary["found"]) == (3, 1)
    assert sum(summary["rejected"].values()) == 2
