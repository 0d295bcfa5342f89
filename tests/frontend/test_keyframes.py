"""Tracking over a rendered flight, with truth to compare against."""

from __future__ import annotations

from collections import Counter
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from frontend.features import Extractor, FeatureConfig
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.keyframes import KeyframeConfig, Tracker
from frontend.tracked import Keyframe
from frontend.tracking_state import TrackingState
from frontend.views import View
from frontend.workers import Workers, share_with
from tests.frontend.floor_pairs import texture
from tests.frontend.small_flight import Image, SmallFlight, small_flight, true_overlap


@pytest.fixture(scope="module")
def flight() -> SmallFlight:
    return small_flight()


def tracker(
    flight: SmallFlight, config: KeyframeConfig = KeyframeConfig(), gates: GateConfig = GateConfig()
) -> Tracker:
    extract = Extractor(FeatureConfig(max_features=300))
    return Tracker(flight.camera, extract, HomographyConfig(), gates, config)


def check_links(flight: SmallFlight, found: list[Keyframe], numbered: dict[int, int] | None = None) -> None:
    """Every link joins neighbours in the list and agrees with the true poses."""
    for number, keyframe in enumerate(found):
        if keyframe.link is None:
            continue
        assert (keyframe.link.i, keyframe.link.j) == (number - 1, number)
        frames = [found[number - 1].frame, keyframe.frame]
        i, j = (flight.w_T_b[f if numbered is None else numbered[f]] for f in frames)
        H = np.linalg.inv(flight.camera.floor_H_image(i)) @ flight.camera.floor_H_image(j)
        corners = flight.camera.corners_px
        error = np.abs(transfer(keyframe.link.i_H_j, corners) - transfer(H, corners)).max()
        assert error < 6 * np.sqrt(keyframe.link.corner_covariance.diagonal().max()) + 0.5


@pytest.mark.parametrize("min_overlap", [pytest.param(0.6, marks=pytest.mark.slow), 0.8])
def test_keyframes_keep_their_overlap_and_no_more_are_made_than_needed(
    flight: SmallFlight, min_overlap: float
) -> None:
    images = flight.images[:45]
    follow = tracker(flight, KeyframeConfig(min_overlap))
    found = list(follow.keyframes(images))
    assert follow.frames == len(images)
    assert not follow.rejected
    assert found[0].frame == 0
    assert found[0].link is None
    frames = [k.frame for k in found]
    assert frames == sorted(set(frames))
    assert frames[-1] == len(images) - 1
    check_links(flight, found)
    overlaps = []
    for before, keyframe in pairwise(found):
        assert keyframe.link is not None
        assert keyframe.link.overlap >= min_overlap
        true = true_overlap(flight.camera, flight.w_T_b[before.frame], flight.w_T_b[keyframe.frame])
        assert keyframe.link.overlap == pytest.approx(true, abs=0.05)
        overlaps.append(true)
        if keyframe.frame + 1 < len(images):  # one frame more would have been too far
            further = true_overlap(
                flight.camera, flight.w_T_b[before.frame], flight.w_T_b[keyframe.frame + 1]
            )
            assert further < min_overlap + 0.03
    assert min_overlap < np.mean(overlaps) < min_overlap + 0.1


def test_unreadable_and_black_pictures_are_counted_and_passed_over(flight: SmallFlight) -> None:
    images: list[Image | None] = list(flight.images[:24])
    images[5] = images[6] = None
    for k in (12, 13, 14):
        images[k] = np.zeros_like(flight.images[0])
    follow = tracker(flight)
    found = list(follow.keyframes(images))
    assert follow.rejected == {"unreadable": 2, "too few features": 3}
    assert follow.frames == 24
    assert not {5, 6, 12, 13, 14} & {k.frame for k in found}
    assert sum(k.link is None for k in found) == 1  # still in view after it: the chain holds
    check_links(flight, found)


def test_bad_first_pictures_do_not_matter(flight: SmallFlight) -> None:
    images: list[Image | None] = [None, np.zeros_like(flight.images[0]), *flight.images[2:12]]
    found = list(tracker(flight).keyframes(images))
    assert found[0].frame == 2
    check_links(flight, found)


def test_tracking_starts_anew_where_the_view_was_lost(flight: SmallFlight) -> None:
    """A cut of a third of a lap: the pictures behind it show another place."""
    black: list[Image | None] = [np.zeros_like(flight.images[0])] * 4
    images = [*flight.images[:15], *black, *flight.images[40:60]]
    true_frame = {k: k if k < 15 else k + 21 for k in range(len(images))}
    assert true_overlap(flight.camera, flight.w_T_b[14], flight.w_T_b[40]) < 0.1
    patience = 3
    follow = tracker(flight, KeyframeConfig(patience=patience))
    found = list(follow.keyframes(images))
    assert follow.rejected["too few features"] == 4
    assert follow.rejected["tracking started anew"] == 1
    anew = [k for k in found[1:] if k.link is None]
    assert [k.frame for k in anew] == [19 + patience]
    dropped = sum(
        n
        for reason, n in follow.rejected.items()
        if reason not in ("too few features", "tracking started anew")
    )
    assert dropped >= patience + 1
    check_links(flight, found, true_frame)


def test_foreign_pictures_are_dropped_with_their_reason(flight: SmallFlight) -> None:
    rng = np.random.default_rng(0)
    images: list[Image | None] = list(flight.images[:14])
    images[7] = texture(rng, 240, 180)
    follow = tracker(flight)
    found = list(follow.keyframes(images))
    assert 7 not in {k.frame for k in found}
    assert sum(follow.rejected.values()) >= 1
    assert set(follow.rejected) <= {
        "too few matches",
        "too few inliers",
        "outlier share above gamma_1",
        "no plane fits the matches",
    }
    assert sum(k.link is None for k in found) == 1
    check_links(flight, found)


def test_failures_apart_from_each_other_do_not_add_up(flight: SmallFlight) -> None:
    rng = np.random.default_rng(2)
    images: list[Image | None] = list(flight.images[:20])
    for k in (4, 7, 10, 13, 16):
        images[k] = texture(rng, 240, 180)
    follow = tracker(flight, KeyframeConfig(patience=2))
    found = list(follow.keyframes(images))
    assert follow.rejected["tracking started anew"] == 0
    assert sum(k.link is None for k in found) == 1


def test_gamma_2_is_reached_and_counted(flight: SmallFlight) -> None:
    strict = tracker(flight, gates=GateConfig(max_relative_change=1.0005))
    list(strict.keyframes(flight.images[:20]))
    assert strict.rejected["change above gamma_2"] > 0


def test_hovering_makes_two_keyframes_and_a_featureless_flight_none(flight: SmallFlight) -> None:
    """Where nothing moves only the ends are kept; where nothing can be matched, nothing is."""
    rng = np.random.default_rng(1)
    still = [
        np.clip(flight.images[3] + rng.normal(0, 2, flight.images[3].shape), 0, 255).astype(np.uint8)
        for _ in range(12)
    ]
    assert [k.frame for k in tracker(flight).keyframes(still)] == [0, 11]
    follow = tracker(flight)
    assert list(follow.keyframes([np.full((180, 240, 3), 80, np.uint8)] * 5)) == []
    assert follow.rejected == {"too few features": 5}
    assert list(tracker(flight).keyframes([])) == []


def test_every_photo_is_a_keyframe_linked_where_it_overlaps(flight: SmallFlight) -> None:
    order = [0, 4, 8, 35, 39]
    images: list[Image | None] = [flight.images[k] for k in order]
    images[3:3] = [None]
    follow = tracker(flight)
    found = list(follow.every(images.__getitem__, len(images)))
    assert [k.frame for k in found] == [0, 1, 2, 4, 5]
    assert [k.link is None for k in found] == [True, False, False, True, False]
    refused = [k.refused for k in found]
    assert [r is not None for r in refused] == [False, False, False, True, False]
    assert refused[3] is not None
    assert (refused[3].i, refused[3].j) == (2, 3)
    assert refused[3].reason
    assert follow.rejected == {"unreadable": 1}
    assert follow.frames == 6
    check_links(flight, found, dict(zip([0, 1, 2, 4, 5], order, strict=True)))


def test_a_black_photograph_is_left_out(flight: SmallFlight) -> None:
    images: list[Image | None] = [flight.images[0], np.zeros_like(flight.images[0]), flight.images[4]]
    follow = tracker(flight)
    assert [k.frame for k in follow.every(images.__getitem__, len(images))] == [0, 2]
    assert follow.dropped == {1: "too few features"}


def test_photographs_are_searched_at_once_with_the_same_result(flight: SmallFlight, monkeypatch) -> None:
    images: list[Image | None] = [flight.images[k] for k in (0, 4, 8)]
    found = []
    for cores in (1, 3):
        monkeypatch.setattr("frontend.features.usable_cores", partial(int, cores))
        with share_with(Workers(cores)):
            found.append(list(tracker(flight).every(images.__getitem__, len(images))))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one.features.pixel, other.features.pixel)
        np.testing.assert_array_equal(one.features.descriptor, other.features.descriptor)


def test_hanging_pictures_and_pictures_of_another_form_are_counted_by_name(flight: SmallFlight) -> None:
    """A camera that hangs shows one picture at many times: none of them but the first is where it says."""
    images: list[Image | None] = list(flight.images[:28])
    images[10:16] = [images[9]] * 6
    images[20] = images[20][:-2]
    images[21] = images[21].astype(np.uint16)  # type: ignore[assignment]
    images[22] = np.dstack([images[22], images[22][..., :1]])
    follow = tracker(flight)
    keyframes = list(follow.keyframes(images))
    assert follow.rejected == {
        "same picture as the one before": 6,
        "of another size than the camera's": 1,
        "neither 8-bit grey nor colour": 2,
    }
    assert not {k.frame for k in keyframes} & {*range(10, 16), 20, 21, 22}
    assert all(k.link is not None for k in keyframes[1:])


FOLLOWED = 3
"""Pictures that come before the features of a keyframe."""


def test_pictures_that_wait_for_a_keyframes_features_are_followed_from_the_one_before(
    flight: SmallFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: Counter[int] = Counter()

    def late(view: View) -> bool:
        asked[view.frame] += 1
        return asked[view.frame] > FOLLOWED

    monkeypatch.setattr(View, "has_features", property(late))
    images, extract = flight.images[:45], Extractor(FeatureConfig(max_features=300))
    follow = Tracker(
        flight.camera, extract, HomographyConfig(), GateConfig(), KeyframeConfig(0.8), look_ahead=False,
        is_urged=lambda features: True,
    )  # fmt: skip
    found = list(follow.keyframes(images))
    check_links(flight, found)
    frames = [keyframe.frame for keyframe in found]
    assert not follow.rejected
    assert sorted([*frames, *(passed.frame for passed in follow.passed)]) == list(range(len(images)))
    assert frames[-1] == len(images) - 1
    waited = [p for p in follow.passed if p.keyframe + 1 < len(frames) and p.frame > frames[p.keyframe + 1]]
    assert len(waited) >= FOLLOWED
    corners = flight.camera.corners_px
    for passed in waited:
        i, j = flight.w_T_b[frames[passed.keyframe]], flight.w_T_b[passed.frame]
        H = np.linalg.inv(flight.camera.floor_H_image(i)) @ flight.camera.floor_H_image(j)
        assert np.abs(transfer(passed.i_H_j, corners) - transfer(H, corners)).max() < 2.0


def test_tracking_goes_on_from_a_state_between_pictures_that_fail(flight: SmallFlight) -> None:
    images = [*flight.images[:6], *flight.images[40:46]]  # another place: each picture there fails at first
    states: list[TrackingState] = []
    follow = tracker(flight, KeyframeConfig(patience=3))
    whole = list(follow.keyframes(images, on_state=lambda state: states.append(state())))
    (state,) = (each for each in states if each.failures == 2)
    again = tracker(flight, KeyframeConfig(patience=3))
    start = again.resumed(state, images.__getitem__)
    found = list(again.keyframes(images[state.frame :], start))
    assert [k.frame for k in found] == [k.frame for k in whole if k.frame >= state.frame]
    assert [k.link is None for k in found] == [k.link is None for k in whole if k.frame >= state.frame]
    assert found[0].link is None
