"""Zoom of the photographs of one camera: which of them have one focal length by all of their tags.

A digital zoom leaves the focal length in millimetres as it is, and cameras write it into different tags.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from slam.core.lens_priors import NOMINAL_FOCAL_STD_RATIO
from slam.io.photos.exif import PhotoTags

_TELLING: tuple[Callable[[PhotoTags], float | None], ...] = (
    lambda tags: tags.focal_35mm,
    lambda tags: tags.calibrated_focal_px,
    lambda tags: tags.dewarp[0] if tags.dewarp is not None else None,
    lambda tags: tags.lens.focal_px[0] if tags.lens is not None else None,
    lambda tags: tags.digital_zoom or 1.0,
)
"""Quantities that change with the zoom by the same factor. They refer to the original size, so that a
photograph that was scaled down later has the same ones."""


def zooms(photos: Sequence[PhotoTags]) -> list[tuple[float, ...]]:
    """Return the zoom of each of n photographs of one camera: per quantity of `_TELLING`, a typical value.

    Values closer than a nominal focal length is known are one zoom. A photograph that does not tell a
    quantity has that of the most photographs.
    """
    columns = [_typical([telling(tags) for tags in photos]) for telling in _TELLING]
    return list(zip(*columns, strict=True))


def _typical(stated: Sequence[float | None]) -> list[float]:
    """Return for each value the median of its group; groups are more than a nominal deviation apart."""
    known = np.array([value for value in stated if value is not None and value > 0])
    if not len(known):
        return [1.0] * len(stated)
    ordered = np.sort(known)
    groups = np.split(ordered, 1 + np.flatnonzero(np.diff(np.log(ordered)) > NOMINAL_FOCAL_STD_RATIO))
    most = float(np.median(max(groups, key=len)))
    typical = {value: float(np.median(group)) for group in groups for value in group.tolist()}
    return [typical.get(value, most) if value is not None else most for value in stated]
