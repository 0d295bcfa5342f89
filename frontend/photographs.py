"""Photographs in their order, each read and searched for features in a job of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, Features
from frontend.masking import unless_hidden
from frontend.picture_check import REDUCTIONS, unusable_reason
from frontend.registration import Registration
from frontend.views import SAME_PICTURE, Load, Masks
from frontend.workers import Ready, workers

Image = NDArray[np.uint8]


@runtime_checkable
class LoadsReduced(Protocol):
    """A loader of pictures that takes less time for smaller ones."""

    def load_reduced(self, k: int, side_px: int | None) -> Image | None:
        """Return picture k, or one smaller by one of ``REDUCTIONS`` whose longer side has at least
        ``side_px``."""


@dataclass(frozen=True)
class Photograph:
    """A usable photograph."""

    frame: int
    features: Features


@dataclass(frozen=True)
class _Search:
    """Inputs that the jobs of all photographs share."""

    load: Load
    reductions: Sequence[int]
    """Ratios of the camera's pictures to those that ``load`` may give."""
    extractor: Extractor
    camera: Camera


@dataclass(frozen=True)
class _Wanted:
    """Task of one job."""

    frame: int
    mask: Image | None
    known: bool
    """Whether the features are known, so that the picture is only looked at."""


@dataclass(frozen=True)
class SearchedPhotograph:
    """Result of one job."""

    digest: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    """Digest of the pixels."""
    unusable: str = ""
    features: Features | None = None


class SearchCheckpoints(Protocol):
    """Results of an earlier run over the same photographs: searches, and links of successive ones."""

    def recall(self, frame: int, mask: Image | None) -> SearchedPhotograph | None:
        """Return the result for a photograph with a mask; None where it is not known."""

    def keep(self, frame: int, found: SearchedPhotograph) -> None:
        """Keep the result for a photograph that was not known, with the mask that was asked for."""

    def link(
        self, number: int, before: Features, features: Features, work: Callable[[], Registration]
    ) -> Registration:
        """Return the link of two successive keyframes, the first of which has a number; by ``work`` where it
        is not known."""


class NoSearchCheckpoints:
    """Nothing is known."""

    def recall(self, frame: int, mask: Image | None) -> SearchedPhotograph | None:
        """Know nothing."""
        return None

    def keep(self, frame: int, found: SearchedPhotograph) -> None:
        """Forget the result."""

    def link(
        self, number: int, before: Features, features: Features, work: Callable[[], Registration]
    ) -> Registration:
        """Do the work."""
        return work()


NO_SEARCH_CHECKPOINTS = NoSearchCheckpoints()


def photographs(
    load: Load,
    count: int,
    extractor: Extractor,
    camera: Camera,
    masks: Masks,
    known: Callable[[int], Features | None],
    checkpoints: SearchCheckpoints = NO_SEARCH_CHECKPOINTS,
) -> Iterator[tuple[int, Photograph | str]]:
    """Yield the number of each of ``count`` photographs, and the photograph or the reason for having none.

    ``masks`` and ``known``: as in `frontend.keyframes.Tracker`.
    """
    earlier: deque[Features | None] = deque()  # of the photographs that are handed out
    new: set[int] = set()

    def wanted() -> Iterator[_Wanted | Ready[SearchedPhotograph | None]]:
        for frame in range(count):
            mask = masks(frame)
            earlier.append(unless_hidden(known(frame), mask, camera))
            is_known = earlier[-1] is not None
            if not is_known and (before := checkpoints.recall(frame, mask)) is not None:
                yield Ready(before)
                continue
            if not is_known:
                new.add(frame)
            yield _Wanted(frame, mask, is_known)

    at_once, before = extractor.config.searched_at_once(camera.size_px), b""
    search = _Search(load, (1,), extractor, camera)
    if isinstance(load, LoadsReduced):
        load = partial(load.load_reduced, side_px=extractor.config.max_side_px)
        search = replace(search, load=load, reductions=REDUCTIONS)
    for frame, found in enumerate(workers().map(_looked_at, search, wanted(), at_once)):
        features = earlier.popleft()
        if found is None:
            yield frame, "unreadable"
            continue
        if frame in new:
            checkpoints.keep(frame, found)
        same, before = found.digest.tobytes() == before, found.digest.tobytes()
        if found.unusable or same:
            yield frame, found.unusable or SAME_PICTURE
            continue
        features = found.features if features is None else features
        assert features is not None
        yield frame, Photograph(frame, features)


def _looked_at(search: _Search, wanted: _Wanted) -> SearchedPhotograph | None:
    """Return the features of a photograph; None if it cannot be read."""
    image = search.load(wanted.frame)
    if image is None:
        return None
    digest = blake2b(f"{image.shape}{image.dtype}".encode(), digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    unusable = unusable_reason(image, search.camera.size_px, search.reductions)
    seen = np.frombuffer(digest.digest(), np.uint8)
    if unusable or wanted.known:
        return SearchedPhotograph(seen, unusable)
    return SearchedPhotograph(seen, features=search.extractor(image, search.camera, wanted.mask))
