"""Which part of a lens moves the positions of two sets of photographs: maps of the same matches with parts of
the lens fixed.

``python -m tests.benchmarks.photo_lenses isfm`` compares with positions by RTK, and
``python -m tests.benchmarks.photo_lenses caliterra`` with the reference by structure from motion.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from frontend.camera import Camera
from frontend.features import FeatureConfig
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.progress import silent
from slam.core.stage_timer import Stopwatch
from slam.evaluation.trajectory import umeyama
from slam.io.photos.import_photos import import_photos
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context, Job
from slam.mapping.map import Map
from slam.mapping.obstacles import no_masks
from slam.mapping.refine import refine_map
from slam.mapping.setup import Setup
from slam.mapping.stages import close_loops, match_overlaps, odometry, refine, solve_again, track
from tests.benchmarks.by_pycolmap import at_its_best, mapped
from tests.benchmarks.caliterra import reference_of
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import rms_length

Array = NDArray[np.float64]
FIXED: Mapping[str, float] = dict.fromkeys(
    ("focal_std_ratio", "aspect_std_ratio", "center_std_px", "radial_std", "tangential_std"), 0.0
)


def matched(flight: Flight) -> tuple[Context, Map]:
    """Return the context of a set and its map, with all pairs of photographs that overlap."""
    assert flight.camera is not None
    job = Job(flight.camera, PipelineConfig(), silent, Stopwatch())
    context, observations = track(job, flight, no_masks)
    first = refine(context, close_loops(context, odometry(context, observations)))
    return context, refine(context, solve_again(context, match_overlaps(context, first)))


def refined(context: Context, map_: Map, camera: Camera, antenna: bool = False) -> tuple[Map, Bundle]:
    """Return the map of the same matches with another camera, and with a free place of the antenna."""
    setup = replace(context.setup, camera=camera)
    found = refine_map(map_, _with_free_antenna(setup) if antenna else setup, silent)
    assert found.bundle is not None
    return found, found.bundle


def _with_free_antenna(setup: Setup) -> Setup:
    fixes = setup.readings.fixes
    assert fixes is not None
    freed = replace(fixes, antenna_std_m=NOMINAL_ANTENNA_STD_M)
    return replace(setup, readings=replace(setup.readings, fixes=freed))


def isfm() -> None:
    """Print the errors at the positions by RTK of maps with parts of the tagged lens fixed."""
    flight = import_photos(folder("photos/isfm"))
    context, map_ = matched(flight)
    stated = context.job.camera
    (cx, cy), (width, height) = stated.center_px, stated.size_px
    center = (width - 1) / 2, (height - 1) / 2
    fixed = replace(stated, **FIXED)
    print("| lens | off, 3-D | forward | left | up | around these |\n|---|---|---|---|---|---|")
    for name, camera, antenna in (
        ("as the tags say", fixed, False),
        ("the same, place of the antenna free (0 ± 0.2 m an axis)", fixed, True),
        ("the same, principal point free", replace(fixed, center_std_px=stated.center_std_px), False),
        ("the same, p1 and p2 free", replace(fixed, tangential_std=stated.tangential_std), False),
        ("the same, k1, k2 and k3 free", replace(fixed, radial_std=stated.radial_std), False),
        ("the same, focal length free", replace(fixed, focal_std_ratio=stated.focal_std_ratio), False),
        (
            "the same, both focal lengths free",
            replace(fixed, focal_std_ratio=stated.focal_std_ratio, aspect_std_ratio=stated.aspect_std_ratio),
            False,
        ),
        ("as the tags say, cy up instead of down", replace(fixed, center_px=(cx, 2 * center[1] - cy)), False),
        ("as the tags say, principal point in the middle", replace(fixed, center_px=center), False),
        (
            "principal point, p1 and p2 free",
            replace(fixed, center_std_px=stated.center_std_px, tangential_std=stated.tangential_std),
            False,
        ),
        ("all free", stated, False),
    ):
        found, bundle = refined(context, map_, camera, antenna)
        off = _off_body_m(flight, found, bundle)
        mean = off.mean(axis=0)
        forward, left, up = mean
        print(
            f"| {name} | {rms_length(off):.3f} m | {forward:+.3f} m | {left:+.3f} m | {up:+.3f} m "
            f"| {rms_length(off - mean):.3f} m |"
        )
        if bundle.lens is not None:
            print("   ", np.round(bundle.lens.calibration, 4).tolist())
        if antenna:
            print("   ", np.round(bundle.antenna_m, 3).tolist())


def _off_body_m(flight: Flight, map_: Map, bundle: Bundle) -> Array:
    """Return (n, 3) how far the antenna lies from the positions by RTK, forward, left and up."""
    gps, origin = flight.gps, flight.geo_origin()
    assert gps is not None
    assert origin is not None
    fixes = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, gps.altitude_m, origin)
    at = np.searchsorted(gps.stamps_s, map_.observations.stamps_s)
    R = map_.w_T_b[:, :3, :3]
    off = map_.w_T_b[:, :3, 3] + R @ bundle.antenna_m - fixes[at]
    return np.asarray(np.einsum("nab,na->nb", R, off))


def caliterra() -> None:
    """Print the distances to the reference of maps and of pycolmap, with parts of the lens fixed."""
    photos = folder("photos/caliterra")
    flight = import_photos(photos)
    context, map_ = matched(flight)
    stated, names = context.job.camera, flight.frames.names if flight.frames is not None else ()
    mine = [names[k] for k in map_.observations.frame_index]
    reference = np.array([reference_of(photos)[name] for name in mine])
    free, _ = refined(context, map_, stated)
    square = replace(stated, tangential_std=0.0)
    print("| positions | to the reference | to our map with all free |\n|---|---|---|")
    for name, camera in (
        ("our map, all free", stated),
        ("our map, p1 and p2 fixed at 0", square),
        ("our map, principal point fixed in the middle", replace(stated, center_std_px=0.0)),
        ("our map, both fixed", replace(square, center_std_px=0.0)),
    ):
        found, bundle = refined(context, map_, camera)
        place, of_free = found.w_T_b[:, :3, 3], free.w_T_b[:, :3, 3]
        print(f"| {name} | {_apart_m(place, reference):.3f} m | {_apart_m(place, of_free):.3f} m |")
        if bundle.lens is not None:
            print("   ", np.round(bundle.lens.calibration, 5).tolist())
    best = at_its_best(FeatureConfig())
    files = sorted(path.name for path in photos.glob("*.jpg"))
    for name, settings in (
        ("pycolmap, principal point and tangential distortion free", best),
        ("pycolmap, its own lens: principal point in the middle, radial", replace(best, free_center=False)),
    ):
        theirs = mapped(photos, files, settings)
        placed = np.array([each in theirs.c_T_w for each in mine])
        center = theirs.centers([each for each in mine if each in theirs.c_T_w])
        ours = free.w_T_b[placed, :3, 3]
        print(f"| {name} | {_apart_m(center, reference[placed]):.3f} m | {_apart_m(center, ours):.3f} m |")


def _apart_m(moving: Array, fixed_m: Array) -> float:
    """Return the RMS distance of positions (n, 3) from others after a similarity."""
    return rms_length(umeyama(moving, fixed_m, with_scale=True).apply(moving) - fixed_m)


if __name__ == "__main__":
    {"isfm": isfm, "caliterra": caliterra}[sys.argv[1]]()
