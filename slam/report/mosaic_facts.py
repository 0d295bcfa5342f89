"""Figures of a mosaic that was written: its pixels, and how accurately the ground lies on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam.report.gaps import Gap


@dataclass(frozen=True)
class MosaicFacts:
    """Size and accuracy of the ground on a mosaic; standard deviations are NaN where they are not known."""

    pixel_m: float
    """Side of a pixel of mosaic.tif on the ground."""
    width: int
    height: int
    typical_std_m: float
    """Median standard deviation of the position of a piece of ground."""
    worst_std_m: float
    x_m: float
    y_m: float
    """Ground with the largest standard deviation."""
    seam_share: float = float("nan")
    """Largest difference in brightness between two pictures of one place, as a share; NaN where no two were
    compared."""
    seam_x_m: float = float("nan")
    seam_y_m: float = float("nan")
    """Ground with the largest difference."""
    seam_typical: float = float("nan")
    """Median difference."""
    covered_share: float = float("nan")
    """Share of the rectangle of the mosaic that pictures show."""
    holes: int = 0
    """Number of places inside that no picture shows."""
    hole_area_m2: float = 0.0
    """Area of all holes together."""
    hole_x_m: float = float("nan")
    hole_y_m: float = float("nan")
    """Middle of the largest hole."""
    worst_pictures: int = 0
    """Number of pictures that show the ground with the largest standard deviation; 0 where not known."""
    gap_area_m2: float = 0.0
    """Ground that no picture shows, below the stretches of the path without usable pictures."""
    hole_beside_m2: float = 0.0
    """Area of the holes that is not below such a stretch."""

    @property
    def missing_m2(self) -> float:
        """Area of all missing ground inside of the map."""
        return self.gap_area_m2 + self.hole_beside_m2

    @property
    def ground_std_m(self) -> tuple[float, float]:
        """Typical and largest standard deviation of the position of a piece of ground."""
        return self.typical_std_m, self.worst_std_m


def mosaic_facts(picture: Path | None, quality: Path | None, gaps: Sequence[Gap] = ()) -> MosaicFacts | None:
    """Return the figures from mosaic.tif beside ``picture`` and from mosaic_quality.tif beside ``quality``.

    ``gaps``: stretches of the path without usable pictures. None where one of the files is missing.
    """
    files = [path.with_suffix(".tif") for path in (picture, quality) if path is not None]
    if len(files) < 2 or not all(path.exists() for path in files):
        return None
    import rasterio

    from slam.report.rasters.quality import quality_figures  # rasters load OpenCV and GDAL

    with rasterio.open(files[0]) as source:
        size, pixel_m = (source.width, source.height), float(source.transform.a)
    return MosaicFacts(pixel_m, *size, **quality_figures(files[1], gaps)._asdict())
