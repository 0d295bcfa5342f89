"""Photographs of a set that were saved a second time, such as smaller files for the web.

A copy shows what the other one shows. Taken as a photograph of its own, it counts the position of both twice.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence

from slam.io.photos.exif import PhotoTags

REASON = "time, place and angles are those of another one, so they are copies; the largest file is used"


def are_copies(photos: Sequence[PhotoTags], file_sizes: Sequence[int]) -> list[bool]:
    """Return which photographs of one camera were made at the moment and place of another, with its angles.

    Of these, the one with the largest of the ``file_sizes`` is no copy. A series from one place within a
    second looks the same, and tells a map no more than one of its photographs.
    """
    alike: dict[Hashable, list[int]] = defaultdict(list)
    for k, tags in enumerate(photos):
        alike[_moment(tags) or k].append(k)
    originals = {max(group, key=lambda k: file_sizes[k]) for group in alike.values()}
    return [k not in originals for k in range(len(photos))]


def _moment(tags: PhotoTags) -> Hashable | None:
    """Return time, place and angles; None where one is missing.

    Times are often whole seconds, and a receiver repeats its place. Only together with the
    angles of a gimbal, which move too, do they tell one moment from another.
    """
    place = tags.position.latitude_deg, tags.position.longitude_deg, tags.position.altitude_m
    angles = tags.gimbal or tags.mount
    if tags.camera_time_ns is None or None in place or angles is None or not any(angles):
        return None
    return tags.camera_time_ns, *place, *angles
