"""Features that masks hide, taken out of keyframes that were tracked without masks.

A robust fit follows the floor as long as most features show it. Tracking the pictures again, with masks,
would then choose the same keyframes: it is enough to register them without the hidden features.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frontend.masking import hides
from frontend.motions import Expectation
from frontend.registration import Registration
from frontend.store import FeatureStore
from frontend.views import Masks
from slam.mapping.front_end import FrontEnd, Observations

MOST_HIDDEN = 0.5
"""Share of the features of a keyframe: the breakdown point of a robust fit."""


def without_hidden(tracked: Observations, front_end: FrontEnd, masks: Masks) -> Observations | None:
    """Return what tracking found without masks, less the features that these masks hide.

    The result is None where the pictures must be tracked again: a mask hides most features of a keyframe, a
    link fails without the hidden ones, or a picture that was dropped shows an obstacle.
    """
    if any(masks(frame) is not None for frame in tracked.dropped):
        return None
    store = FeatureStore()
    for k, frame in enumerate(tracked.frame_index.tolist()):
        features = tracked.store[k]
        seen = ~hides(masks(frame), features.pixel, front_end.camera)
        if np.count_nonzero(seen) < MOST_HIDDEN * len(features):
            return None
        store.append(features if seen.all() else features[seen])
    links = [_linked(link, tracked, store, front_end) for link in tracked.links]
    if not all(link is None or link.ok for link in links):
        return None
    return replace(
        tracked,
        store=store,
        links=tuple(links),
        registrations=tuple(link for link in links if link is not None),
    )


def _linked(
    link: Registration | None, tracked: Observations, store: FeatureStore, front_end: FrontEnd
) -> Registration | None:
    """Return the link between the features that are left."""
    if link is None or all(store.count(k) == tracked.store.count(k) for k in (link.i, link.j)):
        return link
    corners_px = front_end.camera.undistort(front_end.camera.corners_px)
    expected = Expectation.at(link.i_H_j, corners_px)
    return front_end.register(link.i, link.j, store[link.i], store[link.j], expected)
