"""Where the next picture is expected: a floor that goes on as it went, seen from any keyframe."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.corner_track import ALONE, CornerTrack
from frontend.homography import transfer
from frontend.motions import MOST_LEAD

CORNERS = np.array([[0.0, 0.0], [320.0, 0.0], [320.0, 240.0], [0.0, 240.0]])
STEP = np.array([8.0, -3.0])


def test_corners_go_on_as_fast_as_they_went_over_frames_that_were_lost_too() -> None:
    trail = CornerTrack.begin(4, CORNERS)
    assert trail.expected(5) is None
    trail = trail.then(6, CORNERS + 2 * STEP, 0.5, False, 320)
    expected = trail.expected(9)
    assert expected is not None
    assert expected.corners_px == pytest.approx(CORNERS + 5 * STEP)
    assert expected.lead == 0.5


def test_another_keyframe_sees_the_same_places() -> None:
    i_H_j = np.array([[0.9, 0.1, 12.0], [-0.1, 0.95, 4.0], [1e-4, -5e-5, 1.0]])
    trail = CornerTrack.begin(0, CORNERS).then(1, CORNERS + STEP, 0.0, True, 320)
    seen = trail.seen_from(i_H_j).expected(1)
    assert seen is not None
    assert transfer(i_H_j, seen.corners_px) == pytest.approx(CORNERS + STEP)


@pytest.mark.parametrize(
    ("step", "alone", "gains"), [(STEP, True, True), (STEP, False, False), (0 * STEP, True, False)]
)
def test_what_moves_alone_all_over_the_picture_leads_more_and_more(
    step: np.ndarray, alone: bool, gains: bool
) -> None:
    """A hovering vehicle's floor stands still like what is fixed to its camera."""
    trail = CornerTrack.begin(0, CORNERS).then(1, CORNERS + step, 0.0, alone, 320)
    assert trail.lead == pytest.approx(ALONE if gains else 0.0)
    for k in range(2, 60):
        trail = trail.then(k, CORNERS + k * step, trail.lead, alone, 320)
    assert trail.lead == (MOST_LEAD if gains else 0.0)
