"""The pictures of a flight in order, each with its features on demand."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from frontend.features import Features
from frontend.picture_check import unusable_reason

Image = NDArray[np.uint8]

SAME_PICTURE = "same picture as the one before"
"""Reason to drop a picture that equals the one before, pixel by pixel."""

Load = Callable[[int], Image | None]
"""Function of a frame's number: its picture, (h, w) or (h, w, 3) BGR; None if it cannot be read."""
Masks = Callable[[int], Image | None]
"""Function of a frame's number: its mask (h, w), 0 on pixels to ignore; None for none."""


class View:
    """A usable picture of a flight. Its features are extracted on first use, or ahead of it."""

    def __init__(self, frame: int, image: Image, masks: Masks, extract: Extract) -> None:
        self.frame, self.image, self._masks, self._extract = frame, image, masks, extract
        self._coming: Future[Features] | None = None

    def extract_ahead(self, pool: ThreadPoolExecutor) -> Future[Features]:
        """Begin to extract the features in another thread, unless that was done."""
        if self._coming is None:
            self._coming = pool.submit(self._extract, self)
        return self._coming

    @property
    def has_features(self) -> bool:
        """Whether the features that another thread extracts are there."""
        return self._coming is not None and self._coming.done()

    def repeated(self, frame: int) -> View:
        """Return the same picture as another frame."""
        return View(frame, self.image, self._masks, self._extract)

    @cached_property
    def mask(self) -> Image | None:
        """Mask of the picture."""
        return self._masks(self.frame)

    @cached_property
    def features(self) -> Features:
        """Features of the picture."""
        return self._coming.result() if self._coming else self._extract(self)


Extract = Callable[[View], Features]


class Views:
    """Source of views. While ``ahead`` is set, features are extracted before they are asked for."""

    def __init__(
        self, extract: Extract, masks: Masks, size_px: tuple[int, int], at_once: int, look_ahead: bool = True
    ) -> None:
        """``at_once`` pictures are searched for features at a time. Without ``look_ahead`` no picture waits
        for the ones after it, as in flight."""
        self._extract, self._masks, self._size_px, self.ahead = extract, masks, size_px, False
        self._at_once, self._look_ahead = at_once, look_ahead
        self._pool: ThreadPoolExecutor | None = None

    def extract(self, view: View) -> Future[Features]:
        """Begin to extract the features of a view in another thread, while views are taken from `each`."""
        assert self._pool is not None
        return view.extract_ahead(self._pool)

    def each(self, images: Iterable[Image | None], first: int = 0) -> Iterator[tuple[int, View | str]]:
        """Yield the number and the view of each picture, or the reason for having none; the first picture has
        the number ``first``."""
        coming: deque[tuple[int, View | str]] = deque()
        before: Image | None = None
        waiting = self._at_once if self._look_ahead else 0
        with ThreadPoolExecutor(self._at_once) as self._pool:
            for frame, image in enumerate(images, first):
                view = self._view(frame, image, before)
                if self.ahead and waiting and isinstance(view, View):
                    self.extract(view)
                before = image if image is not None else before
                coming.append((frame, view))
                if len(coming) > waiting:
                    yield coming.popleft()
            yield from coming

    def read_again(self, load: Load) -> Callable[[int], View]:
        """Return a function of the number of a usable picture that gives its view, one of each.

        It raises ``LookupError`` where the picture can no longer be read.
        """

        @cache
        def view_of(frame: int) -> View:
            image = load(frame)
            if image is None:
                raise LookupError(f"picture {frame} can no longer be read")
            return View(frame, image, self._masks, self._extract)

        return view_of

    def _view(self, frame: int, image: Image | None, before: Image | None) -> View | str:
        if image is None:
            return "unreadable"
        if reason := unusable_reason(image, self._size_px):
            return reason
        if before is not None and np.array_equal(image, before):
            # A frozen camera: time and position advance, the picture does not.
            return SAME_PICTURE
        return View(frame, image, self._masks, self._extract)
