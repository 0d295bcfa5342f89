"""Mosaic files from an estimate and its flight."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import MosaicError, Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import TOO_FAR, MosaicPlan, plan_mosaic
from frontend.mosaic.render import measure_exposure, render_tiles
from frontend.mosaic.scratch import PictureScratch
from frontend.surface.disagreement import disagreement
from frontend.surface.misregistration import measure_misregistration
from slam.core.checkpoints import NO_CHECKPOINTS, Checkpoints
from slam.core.errors import NO_CAMERA, InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin
from slam.core.lost_pictures import REDUNDANT
from slam.core.progress import Progress, silent
from slam.core.streams import Image
from slam.core.units import percent, unit
from slam.io.geotiff import Block, EarlierBlock, Grid, earlier_blocks, height_tags, write_geotiff, write_png
from slam.report.rasters.checkpoints import JobCheckpoints
from slam.report.rasters.level_ground import is_level, levelled
from slam.report.rasters.look_elsewhere import looking_elsewhere
from slam.report.rasters.picture_loader import PictureLoader
from slam.report.rasters.quality import write_quality
from slam.report.rasters.surface import MeasuredGround, measure_ground, without_unseen

Array = NDArray[np.float64]

MAX_MOSAIC_PIXELS = 60_000_000
MAX_PNG_PIXELS = 40_000_000
CACHE_MB = 256
"""Memory for pictures while tiles are rendered."""
SCRATCH_MB = 900
"""Disk for pictures that this memory does not hold: 3 bytes for each of ``MAX_MOSAIC_PIXELS``, five times,
since the pictures of a survey overlap."""


@dataclass(frozen=True)
class MosaicFiles:
    """The written files and the pictures that they show."""

    geotiff: Path
    png: Path
    world_file: Path
    quality: Path
    """Reliability of each piece of the mosaic: `slam.report.rasters.quality`."""
    gsd_m: float
    """Metres a pixel of the GeoTIFF."""
    png_gsd_m: float
    """Metres a pixel of the PNG, which is reduced where it would be too large to view."""
    width: int
    height: int
    """Size of the GeoTIFF in pixels."""
    pictures: int
    """Number of keyframes in the mosaic."""
    redundant: int
    """Number of usable keyframes whose ground is shown by others."""
    left_out: dict[str, int]
    """Reason -> number of keyframes that could not be used."""
    not_drawn: dict[str, str]
    """Name of each keyframe that the mosaic does not show -> reason, ``REDUNDANT`` among them."""
    partly_drawn: dict[str, str]
    """Name of each keyframe of which the mosaic lacks ground -> how much of it, and why."""
    seam_before: float
    """Brightness difference (rms share) between pictures of one point, as read; NaN without overlap."""
    seam_after: float
    """The same difference after compensation of exposure and vignetting."""
    note: str
    """Choices that were made for the user; empty where there were none."""
    tiles: int
    kept: int
    """Number of tiles copied from the earlier mosaic, because their content is unchanged."""
    ground: MeasuredGround


def write_mosaic(
    estimate: Estimate,
    flight: Flight,
    out_dir: str | Path,
    gsd_m: float | None = None,
    progress: Progress = silent,
    earlier: Path | None = None,
    checkpoints: Checkpoints = NO_CHECKPOINTS,
) -> MosaicFiles:
    """Render the keyframes over the floor into mosaic.tif, .png, .pgw and _quality.tif.

    Unconnected parts of the graph have no position relative to the largest one: without GPS only the largest
    is drawn. A part of photographs that do not look down by their pictures is not drawn either.

    Tiles that the GeoTIFF ``earlier`` already has are copied from it, if they show the same pictures at the
    same poses in the same way. The files are the same as without it. The default is the file in ``out_dir``
    that is replaced. A missing, foreign or damaged file is ignored.

    Raises ``InputError`` where there is no camera or picture, where no picture sees the floor, or where the
    disk refuses; the files of an earlier run then remain unchanged.
    """
    out_dir, poses = Path(out_dir), estimate.over_floor_T_b
    apart, report = _apart(estimate, flight), _stage(progress, "mosaic")
    with _refusal(flight):
        made = _planned(estimate, flight, poses, apart, gsd_m, report, checkpoints)
        made, ground, poses = _over_ground(made, estimate)
    plan = made.plan
    with _put_into(out_dir) as work:
        tif = work / "mosaic.tif"
        with earlier_blocks(earlier or out_dir / "mosaic.tif") as known:
            tiles = _Tiles(made, known)
            write_geotiff(tif, made.grid, tiles.blocks(), height_tags(estimate))
        png_gsd_m = write_png(tif, work / "mosaic.png", MAX_PNG_PIXELS)
        write_quality(plan, made.exposure, estimate, poses, work / "mosaic_quality.tif", ground.height_std_m)
    return MosaicFiles(
        geotiff=out_dir / "mosaic.tif",
        png=out_dir / "mosaic.png",
        world_file=out_dir / "mosaic.pgw",
        quality=out_dir / "mosaic_quality.tif",
        gsd_m=plan.gsd_m,
        png_gsd_m=png_gsd_m,
        width=plan.width,
        height=plan.height,
        pictures=len(plan.views),
        redundant=plan.redundant,
        left_out=dict(Counter(plan.left_out.values())),
        not_drawn=_not_drawn(estimate, plan),
        partly_drawn=_partly_drawn(estimate, plan),
        seam_before=made.exposure.seam_before,
        seam_after=made.exposure.seam_after,
        note=plan.note,
        tiles=tiles.drawn + tiles.kept,
        kept=tiles.kept,
        ground=ground,
    )


def _apart(estimate: Estimate, flight: Flight) -> dict[int, str]:
    """Return the numbers of the keyframes of parts that cannot be drawn beside the largest, with reasons."""
    if estimate.origin is None:
        apart = np.flatnonzero(estimate.component > 0)
        return {int(k): "in a part of the flight that is not tied to the largest" for k in apart}
    return looking_elsewhere(estimate, flight)


def _not_drawn(estimate: Estimate, plan: MosaicPlan) -> dict[str, str]:
    drawn = {view.k for view in plan.views}
    return {
        name: plan.left_out.get(k, REDUNDANT) for k, name in enumerate(estimate.frame_names) if k not in drawn
    }


def _partly_drawn(estimate: Estimate, plan: MosaicPlan) -> dict[str, str]:
    """Return what is said of the ground beyond the mosaic; less than half a percent is not told."""
    return {
        estimate.frame_names[k]: f"{percent(share)} of its ground is {TOO_FAR}"
        for k, share in plan.beyond.items()
        if k not in plan.left_out and share >= 0.005
    }


def write_chain_picture(
    estimate: Estimate,
    flight: Flight,
    out_dir: str | Path,
    w_T_b: Array,
    gsd_m: float | None = None,
    progress: Progress = silent,
    checkpoints: Checkpoints = NO_CHECKPOINTS,
) -> Path:
    """Render the keyframes at other poses (n, 4, 4), of the plain chain, into mosaic_chain.png and .pgw.

    Raises ``InputError`` as `write_mosaic` does.
    """
    out_dir = Path(out_dir)
    with _refusal(flight):
        made = _planned(estimate, flight, w_T_b, {}, gsd_m, _stage(progress, "mosaic_chain"), checkpoints)
    with _put_into(out_dir) as work:
        tif, png = work / "mosaic_chain.tif", work / "mosaic_chain.png"
        blocks = _Tiles(made, lambda mark, shape: None).blocks()
        write_geotiff(tif, made.grid, blocks, most_pixels=MAX_PNG_PIXELS)  # for the PNG alone
        write_png(tif, png, MAX_PNG_PIXELS)
        tif.unlink()
    return out_dir / png.name


@dataclass(frozen=True)
class _Planned:
    """Inputs of the tile rendering."""

    plan: MosaicPlan
    pictures: Pictures
    exposure: Exposure
    origin: GeoOrigin | None
    metric: bool
    progress: Progress

    @property
    def grid(self) -> Grid:
        """Transform of the mosaic's pixels to the ground."""
        plan = self.plan
        corner = plan.west_m, plan.north_m
        return Grid(*corner, plan.gsd_m, plan.width, plan.height, self.origin, self.metric)


def _planned(
    estimate: Estimate,
    flight: Flight,
    w_T_b: Array,
    leave_out: dict[int, str],
    gsd_m: float | None,
    progress: Progress,
    checkpoints: Checkpoints,
) -> _Planned:
    """Content and brightness of the pictures at poses (n, 4, 4), without those left out for a reason."""
    camera, frames = estimate.camera or flight.camera, flight.frames
    if camera is None or frames is None:
        raise InputError(f"{flight.name}: no camera pictures, so no mosaic; {NO_CAMERA}")
    length = unit(estimate.metric)
    if gsd_m is not None and not (math.isfinite(gsd_m) and gsd_m > 0):
        raise InputError(f"ground resolution {gsd_m} {length}/pixel: give a number above 0")

    load = PictureLoader.of(estimate, frames, camera)
    jobs = JobCheckpoints(checkpoints, frames, estimate.frame_index)

    def planned(leave_out: dict[int, str]) -> MosaicPlan:
        return plan_mosaic(
            camera, w_T_b, estimate.floor_z_m, gsd_m, MAX_MOSAIC_PIXELS, leave_out, unit=length
        )

    plan, scratch = planned(leave_out), PictureScratch(SCRATCH_MB)
    while True:
        pictures = Pictures(plan, load, CACHE_MB, checkpoints=jobs, scratch=scratch)
        exposure = measure_exposure(plan, pictures, progress)
        if not pictures.unusable:
            return _Planned(plan, pictures, exposure, estimate.origin, estimate.metric, progress)
        # The area of unusable pictures goes to others, perhaps to some that were not read yet.
        leave_out = leave_out | pictures.unusable
        plan = planned(leave_out)


@contextmanager
def _refusal(flight: Flight) -> Iterator[None]:
    """Turn the reason why no mosaic can be planned into ``InputError``."""
    try:
        yield
    except MosaicError as error:
        raise InputError(f"{flight.name}: {error}") from None


def _over_ground(made: _Planned, estimate: Estimate) -> tuple[_Planned, MeasuredGround, Array]:
    """Measure the ground, and plan again over it where it is not flat, or where it slopes.

    The third result is the poses (n, 4, 4) over the plan.
    """
    plan, over_floor = made.plan, estimate.over_floor_T_b
    ground = measure_ground(plan, made.pictures, over_floor, estimate.elevation, made.progress)
    if not is_level(estimate, plan, ground):
        level = levelled(ground, plan, estimate)
        return *_planned_over(made, level, estimate, estimate.w_T_b), estimate.w_T_b
    if ground.surface is None:
        return made, ground, over_floor
    return *_planned_over(made, ground, estimate, over_floor), over_floor


def _planned_over(
    made: _Planned, ground: MeasuredGround, estimate: Estimate, poses: Array
) -> tuple[_Planned, MeasuredGround]:
    """Plan the mosaic again over the surface of the ground, which the first plan has chosen."""
    plan, surface, bounds_m, lowest_m = made.plan, ground.surface, made.plan.bounds_m, 0.0
    assert surface is not None
    if ground.over_plane is not None:
        # Cameras over the foot of a hillside may be below the floor, whose height is that at the origin.
        bounds_m, lowest_m = ground.over_plane.bounds_m, float(surface.height_m.min())
    over = plan_mosaic(
        plan.camera, poses, estimate.floor_z_m + lowest_m, plan.gsd_m, MAX_MOSAIC_PIXELS, plan.left_out,
        unit(estimate.metric), replace(surface, height_m=surface.height_m - np.float32(lowest_m)), bounds_m,
    )  # fmt: skip
    over = replace(over, note=plan.note, beyond=plan.beyond)
    pictures = made.pictures.over(over)
    exposure = measure_exposure(over, pictures, made.progress)
    over_surface = measure_misregistration(over, pictures, made.progress)
    ground = replace(
        ground,
        surface=without_unseen(surface, over),
        over_surface=over_surface,
        disagreement=disagreement(over_surface, over),
    )
    return replace(made, plan=over, pictures=pictures, exposure=exposure), ground


@contextmanager
def _put_into(out_dir: Path) -> Iterator[Path]:
    """Temporary folder whose files are moved into ``out_dir`` once all are complete."""
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".mosaic-", dir=out_dir) as name:
            work = Path(name)
            yield work
            for path in sorted(work.iterdir()):
                path.replace(out_dir / path.name)
    except OSError as error:
        raise InputError(
            f"{out_dir}: cannot be written ({error.strerror or error}); choose another folder or free space"
        ) from None


@dataclass
class _Tiles:
    """Render the mosaic's pixels tile by tile; also return how many tiles were rendered."""

    made: _Planned
    known: EarlierBlock
    drawn: int = 0
    kept: int = 0

    def blocks(self) -> Iterator[Block]:
        def earlier(tile: Tile, mark: str) -> Image | None:
            return self.known(mark, (tile.rows, tile.cols))

        made = self.made
        for done in render_tiles(made.plan, made.pictures, made.exposure, made.progress, earlier):
            self.kept, self.drawn = self.kept + done.reused, self.drawn + (not done.reused)
            yield Block(done.tile.row, done.tile.col, done.rgba, done.fingerprint)


def _stage(progress: Progress, stem: str) -> Progress:
    """Name the stages after the file that is made."""

    def tell(stage: str, done: int, total: int) -> None:
        progress(stem if stage == "mosaic" else f"{stem} {stage}", done, total)

    return tell
