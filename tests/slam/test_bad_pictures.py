"""The whole job on pictures that show nothing, or are damaged."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slam.core.messages import about, unread
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown, only, seeing
from tests.slam.whole_job import assert_whole, refusal

BLACK = np.zeros((144, 176, 3), np.uint8)


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("plain floor", "98 x too few features"),
        ("grey", "98 x too few features"),
        ("damaged", "98 x unreadable"),
    ],
)
def test_pictures_without_anything_to_see_are_refused_with_the_reason(what, reason):
    if what == "plain floor":
        flight = flown(0, world={"texture": "plain", "mark_diameter_m": 0.0})
    else:
        flight = seeing(flown(0), lambda k: np.full((144, 176), 120, np.uint8) if what == "grey" else None)
    message = refusal(flight)
    assert "0 of 98 pictures usable" in message
    assert reason in message


def test_one_picture_is_too_few():
    assert "1 of 1 pictures usable" in refusal(only(flown(0), [5]))
    assert "1 of 3 pictures usable (2 x unreadable)" in refusal(
        seeing(only(flown(0), [5, 6, 7]), lambda k: None if k else flown(0).frames.load(5))
    )


@pytest.mark.slow
def test_damaged_pictures_are_counted_and_left_out():
    flight = flown(0)
    broken = seeing(flight, lambda k: None if k % 10 == 3 else flight.frames.load(k))
    estimate = optimize(broken)
    assert estimate.rejected["unreadable"] == 10
    assert not {k for k in estimate.frame_index.tolist() if k % 10 == 3}
    assert estimate.status == "ok"
    assert evaluate(estimate, broken).ate_m.rmse < 3e-3


@pytest.mark.slow
def test_black_seconds_are_bridged_by_loops():
    """Tracking starts anew behind them; places seen before join the two halves again."""
    flight = flown(0)
    dark = seeing(flight, lambda k: BLACK if 38 <= k < 62 else flight.frames.load(k))
    estimate = optimize(dark)
    assert estimate.rejected["too few features"] == 24
    assert estimate.rejected["tracking started anew"] == 1
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert evaluate(estimate, dark).ate_m.rmse < 4e-3
    assert np.isfinite(estimate.chain_w_T_b).all(), "the instruments carry the chain over the gap"


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("spoil", "reason", "count"),
    [
        pytest.param(
            lambda load, k: load(30) if 30 <= k < 42 else load(k), "same picture as the one before", 11,
            id="frozen", marks=SLOW,
        ),
        pytest.param(
            lambda load, k: load(k - k % 2), "same picture as the one before", 49, id="each twice", marks=SLOW
        ),
        pytest.param(
            lambda load, k: load(k)[:120] if 30 <= k < 42 else load(k), "of another size than the camera's",
            12, id="another size", marks=SLOW,
        ),
        pytest.param(
            lambda load, k: load(k).astype(np.uint16) if 30 <= k < 42 else load(k),
            "neither 8-bit grey nor colour", 12, id="16 bit", marks=SLOW,
        ),
        pytest.param(
            lambda load, k: 0 * load(k) + 255 if 30 <= k < 42 else load(k), "too few features", 12,
            id="white", marks=SLOW,
        ),
        pytest.param(
            lambda load, k: load(k)[..., ::-1].copy() if k % 2 else load(k), "", 0, id="colours swapped",
            marks=SLOW,
        ),
    ],
)  # fmt: skip
def test_bad_pictures_are_counted_by_name_and_survived(spoil, reason, count):
    flight = flown(0)
    spoiled = seeing(flight, lambda k: spoil(flight.frames.load, k))
    estimate = optimize(spoiled)
    assert estimate.rejected.get(reason, 0) == count
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert evaluate(estimate, spoiled).ate_m.rmse < 3e-3


def test_a_camera_without_rows_and_one_picture_alone_are_reported_as_such():
    flight = flown(0)
    told = flight.with_warning(unread("data.csv has no rows", "treated as not recorded").named("cam0"))
    assert "cam0: data.csv has no rows, so no map" in refusal(replace(told, camera=None, frames=None))
    assert "no camera in this flight, so no map" in refusal(replace(flight, camera=None, frames=None))
    alone = only(flight, [0]).with_warning(
        about("cam0", "47 files in data/ not listed in data.csv and ignored")
    )
    assert "1 of 1 pictures usable (there is one alone; cam0: 47 files" in refusal(alone)


@pytest.mark.slow
@pytest.mark.parametrize("odd", [{40}, {0, 24, 58}, set(range(0, 98, 2))], ids=["one", "three", "half"])
def test_pictures_of_two_zooms_are_told(odd):
    """Pictures cut to their middle and enlarged put the camera lower by a quarter: other sensors disagree."""
    load = flown(0).frames.load
    estimate = optimize(seeing(flown(0), lambda k: _zoomed(load(k)) if k in odd else load(k)))
    assert "another camera or zoom" in estimate.status
    assert "imu0 and sonar0" in estimate.status


def _zoomed(image):
    height, width = image.shape[:2]
    middle = image[height // 8 : -height // 8, width // 8 : -width // 8]
    return cv2.resize(middle, (width, height))
