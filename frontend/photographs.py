"""Photographs in their order, each read and searched for features in a job of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, Features
from frontend.masking import unless_hidden
from frontend.picture_check import REDUCTIONS, unusable_reason
from frontend.views import SAME_PICTURE, Load, Masks
from frontend.workers import workers

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
class _Found:
    """Result of one job."""

    digest: bytes = b""
    unusable: str = ""
    features: Features | None = None


def photographs(
    load: Load,
    count: int,
    extractor: Extractor,
    camera: Camera,
    masks: Masks,
    known: Callable[[int], Features | None],
) -> Iterator[tuple[int, Photograph | str]]:
    """Yield the number of each of ``count`` photographs, and the photograph or the reason for having none.

    ``masks`` and ``known``: as in `frontend.keyframes.Tracker`.
    """
    earlier: deque[Features | None] = deque()  # of the photographs that are handed out

    def wanted() -> Iterator[_Wanted]:
        for frame in range(count):
            mask = masks(frame)
            earlier.append(unless_hidden(known(frame), mask, camera))
            yield _Wanted(frame, mask, earlier[-1] is not None)

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
        same, before = found.digest == before, found.digest
        if found.unusable or same:
            yield frame, found.unusable or SAME_PICTURE
            continue
        features = found.features if features is None else features
        assert features is not None
        yield frame, Photograph(frame, features)


def _looked_at(search: _Search, wanted: _Wanted) -> _Found | None:
    """Return the features of a photograph; None if it cannot be read."""
    image = search.load(wanted.frame)
    if image is None:
        return None
    digest = blake2b(f"{image.shape}{image.dtype}".encode(), digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    unusable = unusable_reason(image, search.camera.size_px, search.reductions)
    if unusable or wanted.known:
        return _Found(digest.digest(), unusable)
    return _Found(digest.digest(), features=search.extractor(image, search.camera, wanted.mask))
