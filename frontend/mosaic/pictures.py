"""Pictures of a planned mosaic: read on demand, reduced to its resolution, kept in limited memory."""

from __future__ import annotations

from collections import OrderedDict
from hashlib import sha256
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.checkpoints import NO_MOSAIC_CHECKPOINTS, MosaicCheckpoints
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.scratch import PictureScratch
from frontend.mosaic.view import MosaicView
from frontend.picture_check import unusable_reason
from frontend.views import Load

Image = NDArray[np.uint8]

DARK, BRIGHT = 3, 252
"""Limits of the grey levels that are used to estimate the exposure."""


class Pictures:
    """Pictures of the plan, at most at the mosaic's resolution, in a least-recently-used cache.

    Several threads may use them. A copy in another process reads them anew.
    """

    def __init__(
        self,
        plan: MosaicPlan,
        load: Load,
        max_mb: float = 256,
        is_copy: bool = False,
        checkpoints: MosaicCheckpoints = NO_MOSAIC_CHECKPOINTS,
        scratch: PictureScratch | None = None,
    ) -> None:
        """``checkpoints``: what an earlier run found, for the process that hands out the jobs. ``scratch``:
        where pictures are kept that are not in memory; None reads them again."""
        self.checkpoints, self.scratch = checkpoints, scratch
        self._plan, self._load, self.max_mb, self._is_copy = plan, load, max_mb, is_copy
        self._cache: OrderedDict[int, Image] = OrderedDict()
        self._bytes = 0
        self._digests: dict[int, bytes] = {}
        self._reading, self._caching = [Lock() for _ in plan.views], Lock()
        self.unusable: dict[int, str] = {}
        """Pose number -> reason why its picture cannot be used."""

    def __reduce__(self) -> tuple[type[Pictures], tuple[MosaicPlan, Load, float, bool]]:
        return Pictures, (self._plan, self._load, self.max_mb, True)

    def over(self, plan: MosaicPlan) -> Pictures:
        """Return the pictures of another plan, of which those of the same size are not read again."""
        return Pictures(plan, self._load, self.max_mb, checkpoints=self.checkpoints, scratch=self.scratch)

    @property
    def lost(self) -> bool:
        """Whether a copy cannot use all pictures; a plan that is copied has usable ones alone."""
        return self._is_copy and bool(self.unusable)

    def __getitem__(self, index: int) -> Image | None:
        """Return the picture of ``plan.views[index]`` as (h, w, 3) BGR, or None if it is unusable."""
        with self._reading[index]:  # by one thread alone
            with self._caching:
                if index in self._cache:
                    self._cache.move_to_end(index)
                    return self._cache[index]
            picture = self._read(index)
            if picture is not None:
                if index not in self._digests:
                    self._digests[index] = _digest(picture)
                with self._caching:
                    self._keep(index, picture)
            return picture

    def _read(self, index: int) -> Image | None:
        view = self._plan.views[index]
        if view.k in self.unusable:
            return None
        size_px = self._size_px(view)
        if self.scratch is not None and (kept := self.scratch.recall(view.k, size_px)) is not None:
            return kept
        picture = self._load(view.k)
        # One with a digest was usable when it was read before.
        known = picture is not None and index in self._digests
        reason = "" if known else _unusable_reason(picture, self._plan.camera.size_px)
        if picture is None or reason:
            self.unusable[view.k] = reason
            return None
        if picture.ndim == 2:
            picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        if picture.shape[1::-1] != size_px:
            picture = cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
        if self.scratch is not None:
            self.scratch.keep(view.k, picture)
        return picture

    def _size_px(self, view: MosaicView) -> tuple[int, int]:
        """Return the (width, height) at which a picture is drawn."""
        w, h = self._plan.camera.size_px
        ratio = self._plan.gsd_m / view.gsd_m
        return (max(2, round(w / ratio)), max(2, round(h / ratio))) if ratio > 1.2 else (w, h)

    def _keep(self, index: int, picture: Image) -> None:
        self._cache[index] = picture
        self._bytes += picture.nbytes
        while self._bytes > self.max_mb * 1e6 and len(self._cache) > 1:
            self._bytes -= self._cache.popitem(last=False)[1].nbytes

    def seen(self, index: int, digest: bytes) -> None:
        """Note the digest of a usable picture that another process has read."""
        self._digests[index] = digest

    def digest(self, index: int) -> bytes:
        """Return the digest of the picture of ``plan.views[index]``, or b"" if it is unusable."""
        if index not in self._digests and self[index] is None:
            return b""
        return self._digests[index]


def _digest(picture: Image) -> bytes:
    digest = sha256(repr(picture.shape).encode())
    digest.update(np.ascontiguousarray(picture).data)
    return digest.digest()


def _unusable_reason(picture: Image | None, size_px: tuple[int, int]) -> str:
    if picture is None:
        return "cannot be read"
    if reason := unusable_reason(picture, size_px):
        return reason
    extreme = np.count_nonzero((picture <= DARK) | (picture >= BRIGHT))
    return "black or blown out" if extreme > 0.95 * picture.size else ""
