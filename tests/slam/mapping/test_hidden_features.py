"""Keyframes without the features that masks hide: the same ones, registered again where something is gone."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from frontend.masking import hides
from frontend.views import Masks
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.hidden_features import without_hidden
from slam.mapping.obstacles import no_masks
from tests.slam.small_flight import flown, only


@lru_cache
def tracked() -> tuple[Flight, FrontEnd, Observations]:
    flight = only(flown(0), range(20))
    front_end = FrontEnd(flight, flight.camera, PipelineConfig(), silent)
    return flight, front_end, front_end.track()


def hiding(frame: int, share: float) -> Masks:
    """Return masks that hide a share of the width of one picture, and an empty one of every other."""
    flight, _, _ = tracked()
    width, height = flight.camera.size_px

    def mask(which: int) -> np.ndarray:
        hidden = np.full((height, width), 255, np.uint8)
        hidden[:, : int(share * width)] = 0 if which == frame else 255
        return hidden

    return mask


def test_hidden_features_are_gone_and_only_their_links_are_made_again():
    flight, front_end, observations = tracked()
    k = len(observations.frame_index) // 2
    masks = hiding(int(observations.frame_index[k]), 0.25)
    left = without_hidden(observations, front_end, masks)
    assert left.frame_index.tolist() == observations.frame_index.tolist()
    assert left.store.count(k) < observations.store.count(k)
    assert not hides(masks(left.frame_index[k]), left.store[k].pixel, flight.camera).any()
    for i, (before, after) in enumerate(zip(observations.links, left.links, strict=True)):
        if i in (k, k + 1):
            assert after.ok
            assert after.i_H_j[:2, 2] == pytest.approx(before.i_H_j[:2, 2], abs=1.0)
            assert after.matches[:, 1 - (i - k)].max() < left.store.count(k)
        else:
            assert after is before
    assert left.registrations == left.links[1:]


def test_masks_that_hide_nothing_change_nothing():
    _, front_end, observations = tracked()
    left = without_hidden(observations, front_end, no_masks)
    assert left.links == observations.links
    assert all(left.store.digest(k) == observations.store.digest(k) for k in range(len(left.store)))


def test_pictures_are_tracked_again_where_obstacles_may_have_led_tracking():
    """A mask hides most of a keyframe, or a dropped picture shows an obstacle."""
    _, front_end, observations = tracked()
    most = hiding(int(observations.frame_index[1]), 0.8)
    assert without_hidden(observations, front_end, most) is None
    lost = replace(observations, dropped={3: "too few matches"})
    assert without_hidden(lost, front_end, hiding(-1, 0.0)) is None
    assert without_hidden(lost, front_end, no_masks) is not None
