"""From an estimate and its flight to mosaic files."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import MosaicError, Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.render import Pictures, measure_exposure, render_tiles
from slam.errors import NO_CAMERA, InputError
from slam.estimate import Estimate
from slam.flight import Flight, Image
from slam.io.geotiff import Block, EarlierBlock, Grid, earlier_blocks, write_geotiff, write_png
from slam.progress import Progress, silent
from slam.rasters.quality import write_quality

Array = NDArray[np.float64]

MAX_MOSAIC_PIXELS = 60_000_000
MAX_PNG_PIXELS = 40_000_000
CACHE_MB = 256
"""Pictures held in memory while tiles are rendered."""


@dataclass(frozen=True)
class MosaicFiles:
    """What was written, and from what."""

    geotiff: Path | None
    png: Path
    world_file: Path | None
    quality: Path | None
    """How far each piece is to be trusted: `slam.rasters.quality`."""
    gsd_m: float
    """Metres a pixel of the GeoTIFF."""
    png_gsd_m: float
    """Of the PNG, which is reduced where it would be too large to view."""
    width: int
    height: int
    """Pixels of the GeoTIFF."""
    pictures: int
    """In the mosaic."""
    redundant: int
    """Usable, but others show their ground as well."""
    left_out: dict[str, int]
    """Reason -> number of keyframes that could not be used."""
    seam_before: float
    """Brightness difference (rms share) between pictures of one point, as read; NaN without overlap."""
    seam_after: float
    """The same after exposure and vignetting were compensated."""
    note: str
    """What was decided for the user; empty where nothing was."""
    tiles: int
    kept: int
    """Tiles whose pixels were taken from the earlier mosaic: nothing that they show has changed."""


def write_mosaic(
    estimate: Estimate,
    flight: Flight,
    out_dir: str | Path,
    gsd_m: float | None = None,
    progress: Progress = silent,
    poses: Array | None = None,
    stem: str = "mosaic",
    picture_only: bool = False,
    earlier: Path | None = None,
) -> MosaicFiles:
    """Render the keyframes over the floor into ``stem``.tif, .png, .pgw and _quality.tif, or the PNG alone.

    ``poses`` (n, 4, 4) replace the optimized ones (to show the chain beside them). Parts of the graph that
    are tied to nothing have no place relative to the largest one: without GPS only the largest is drawn.

    Tiles that the GeoTIFF ``earlier`` has already, made of the same pictures at the same places in the same
    way, are taken from it; the files come out the same as without it. Where none is given it is the one that
    stands in ``out_dir`` and is replaced; one that is missing, foreign or damaged gives nothing.

    Raises ``InputError`` where there is no camera or picture, where no picture sees the floor, or where the
    disk refuses; the files of an earlier run then stand as they were.
    """
    camera, frames = estimate.camera or flight.camera, flight.frames
    if camera is None or frames is None:
        raise InputError(f"{flight.name}: no camera pictures, so no mosaic; {NO_CAMERA}")
    if gsd_m is not None and not (math.isfinite(gsd_m) and gsd_m > 0):
        raise InputError(f"ground resolution {gsd_m} m/pixel: give a number above 0")
    w_T_b = estimate.over_floor_T_b if poses is None else np.asarray(poses, dtype=float)
    leave_out: dict[int, str] = {}
    if estimate.origin is None and poses is None:
        apart = np.flatnonzero(estimate.component > 0)
        leave_out = {int(k): "in a part of the flight that is not tied to the largest" for k in apart}

    def load(k: int) -> Image | None:
        return frames[int(estimate.frame_index[k])].read()

    out_dir = Path(out_dir)
    try:
        plan = plan_mosaic(camera, w_T_b, estimate.floor_z_m, gsd_m, MAX_MOSAIC_PIXELS, leave_out)
        while True:
            pictures = Pictures(plan, load, CACHE_MB)
            exposure = measure_exposure(plan, pictures, _stage(progress, stem))
            if not pictures.unusable:
                break
            # What the unusable pictures owned goes to others, perhaps to some not read so far.
            leave_out = leave_out | pictures.unusable
            plan = plan_mosaic(camera, w_T_b, estimate.floor_z_m, gsd_m, MAX_MOSAIC_PIXELS, leave_out)
    except MosaicError as error:
        raise InputError(f"{flight.name}: {error}") from None
    return _write(
        plan, pictures, exposure, estimate, out_dir, progress, stem, picture_only,
        earlier or out_dir / f"{stem}.tif",
    )  # fmt: skip


def _write(
    plan: MosaicPlan,
    pictures: Pictures,
    exposure: Exposure,
    estimate: Estimate,
    out_dir: Path,
    progress: Progress,
    stem: str,
    picture_only: bool,
    earlier: Path,
) -> MosaicFiles:
    """All files of one mosaic are complete before the first takes its place."""
    grid = Grid(plan.west_m, plan.north_m, plan.gsd_m, plan.width, plan.height, estimate.origin)
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{stem}-", dir=out_dir) as name:
            work = Path(name)
            tif, png = work / f"{stem}.tif", work / f"{stem}.png"
            with earlier_blocks(earlier) as known:
                tiles = _Tiles(plan, pictures, exposure, known, _stage(progress, stem))
                write_geotiff(tif, grid, tiles.blocks())
            png_gsd_m = write_png(tif, png, MAX_PNG_PIXELS, world_file=not picture_only)
            if picture_only:
                tif.unlink()
            else:
                write_quality(plan, exposure, estimate, work / f"{stem}_quality.tif")
            for path in sorted(work.iterdir()):
                path.replace(out_dir / path.name)
    except OSError as error:
        raise InputError(
            f"{out_dir}: cannot be written ({error.strerror or error}); choose another folder or free space"
        ) from None
    return MosaicFiles(
        geotiff=None if picture_only else out_dir / f"{stem}.tif",
        png=out_dir / f"{stem}.png",
        world_file=None if picture_only else out_dir / f"{stem}.pgw",
        quality=None if picture_only else out_dir / f"{stem}_quality.tif",
        gsd_m=plan.gsd_m,
        png_gsd_m=png_gsd_m,
        width=plan.width,
        height=plan.height,
        pictures=len(plan.views),
        redundant=plan.redundant,
        left_out=dict(Counter(plan.left_out.values())),
        seam_before=exposure.seam_before,
        seam_after=exposure.seam_after,
        note=plan.note,
        tiles=tiles.drawn + tiles.kept,
        kept=tiles.kept,
    )


@dataclass
class _Tiles:
    """The mosaic's pixels, tile by tile, and how many were rendered for it."""

    plan: MosaicPlan
    pictures: Pictures
    exposure: Exposure
    known: EarlierBlock
    progress: Progress
    drawn: int = 0
    kept: int = 0

    def blocks(self) -> Iterator[Block]:
        def earlier(tile: Tile, mark: str) -> Image | None:
            return self.known(mark, (tile.rows, tile.cols))

        for done in render_tiles(self.plan, self.pictures, self.exposure, self.progress, earlier):
            self.kept, self.drawn = self.kept + done.kept, self.drawn + (not done.kept)
            yield Block(done.tile.row, done.tile.col, done.rgba, done.fingerprint)


def _stage(progress: Progress, stem: str) -> Progress:
    """Name the stages after the file that is made."""

    def tell(stage: str, done: int, total: int) -> None:
        progress(stem if stage == "mosaic" else f"{stem} {stage}", done, total)

    return tell
