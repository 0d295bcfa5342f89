"""The messages of a map that grows: what is new at each moment, in the order in which it is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.streams import Image
from slam.io.exports.bag_messages import BODY, CAMERA, WORLD
from slam.io.exports.foxglove import messages
from slam.io.exports.foxglove.foxglove_file import FoxgloveFile
from slam.io.exports.foxglove.links import COLOURS
from slam.io.exports.foxglove.pictures import WIDTH_PX, jpeg

Array = NDArray[np.float64]

_WHOLE_SHARE = 1 / 3
"""Bytes of paths and links over those of pictures: each of them holds the whole map, so that all of them
together would grow with the square of the flight."""
_POSE_BYTES, _END_BYTES = 71, 29
"""A pose and an end of a link in protobuf: seven and three numbers of 8 bytes, a tag each, and heads."""


class LiveMap:
    """Writes a growing map. ``load`` returns the picture of a frame.

    A keyframe is written once, with the pose that it has when it is placed first. The path and the links hold
    the current poses of all.
    """

    def __init__(self, file: FoxgloveFile, camera: Camera, load: Callable[[int], Image | None]) -> None:
        self._file, self._camera, self._load = file, camera.narrowed(WIDTH_PX), load
        self._written: set[int] = set()
        self._now_ns = 0
        """Time of the newest message: what is known of an earlier keyframe is known only then."""
        self._picture_bytes = self._whole_bytes = 0

    def update(
        self,
        frames: NDArray[np.int64],
        stamps_ns: NDArray[np.int64],
        w_T_b: Array,
        links: Mapping[str, NDArray[np.int64]],
        is_end: bool = False,
    ) -> None:
        """Write what is new of keyframes with frame numbers (n,), stamps (n,) and poses (n, 4, 4).

        NaN leaves a keyframe out. ``links`` are pairs (m, 2) of keyframes by verdict, a key of ``COLOURS``.
        """
        placed = np.asarray(np.isfinite(w_T_b).all(axis=(1, 2)))
        new = [k for k in np.flatnonzero(placed).tolist() if int(frames[k]) not in self._written]
        for k in new:
            self._add_keyframe(int(frames[k]), int(stamps_ns[k]), w_T_b[k])
        shown = {verdict: pairs[placed[pairs].all(axis=1)] for verdict, pairs in links.items()}
        size = _POSE_BYTES * int(placed.sum()) + _END_BYTES * sum(pairs.size for pairs in shown.values())
        is_due = is_end or self._whole_bytes + size <= _WHOLE_SHARE * self._picture_bytes
        if placed.any() and (new or is_end) and is_due:
            self._whole_bytes += size
            self._add_whole(w_T_b, placed, shown)

    def _add_keyframe(self, frame: int, stamp_ns: int, w_T_b: Array) -> None:
        self._now_ns = max(self._now_ns, stamp_ns)
        if not self._written:
            mount = messages.transforms(stamp_ns, BODY, CAMERA, self._camera.b_T_c)
            self._file.add("/tf_static", self._now_ns, mount)
        self._written.add(frame)
        self._file.add("/tf", self._now_ns, messages.transforms(stamp_ns, WORLD, BODY, w_T_b))
        self._file.add("/slam/pose", self._now_ns, messages.pose_in_frame(stamp_ns, w_T_b))
        picture = self._load(frame)
        if picture is not None:
            content = jpeg(picture, self._camera)
            self._picture_bytes += len(content)
            calibration = messages.calibration(stamp_ns, self._camera)
            self._file.add("/camera/calibration", self._now_ns, calibration)
            self._file.add("/camera/image", self._now_ns, messages.image(stamp_ns, content))

    def _add_whole(
        self, w_T_b: Array, placed: NDArray[np.bool_], links: Mapping[str, NDArray[np.int64]]
    ) -> None:
        now_ns, at = self._now_ns, w_T_b[:, :3, 3]
        entities = [messages.lines(now_ns, name, at[pairs], COLOURS[name]) for name, pairs in links.items()]
        self._file.add("/slam/path", now_ns, messages.path(now_ns, w_T_b[placed]))
        self._file.add("/slam/links", now_ns, messages.scene(entities))
