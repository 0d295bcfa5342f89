"""75 aerial photographs with a coarse GPS, compared with structure from motion, GPS and pycolmap."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.features import FeatureConfig
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, geodetic_from_enu
from slam.core.streams import Gps
from slam.evaluation import evaluate
from slam.evaluation.trajectory import Similarity, umeyama
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from tests.benchmarks.apart import Took, timed
from tests.benchmarks.by_pycolmap import Mapped, Settings, against_best, at_its_best, mapped
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most, reported, rms_length

Array = NDArray[np.float64]

GOOD_GPS_TILT_DEG, GOOD_GPS_STD_M = 3.0, 0.3
PYCOLMAP_SIDE_PX = 1000
LEANS = (
    "the GPS altitude climbs on while the scale of the pictures stays the same; the reference, put on the GPS"
    " by a similarity, leans to follow it, our map stays level"
)
HELD_CENTER = "that reference holds the principal point in the middle and has no tangential distortion"
CLIMB_PHOTOS = 10
"""The vehicle climbs while the first ones are taken."""


@dataclass(frozen=True)
class Positions:
    """Camera positions of the placed photos, in metres, east north up."""

    ours_m: Array
    reference_m: Array
    gps_m: Array


def measure() -> list[Metric]:
    """Return all figures, without pycolmap's time where the package is missing."""
    photos = folder("photos/caliterra")
    with timed() as took:
        flight = import_photos(photos)
        estimate = optimize(flight)
    placed = estimate.component == 0
    positions = positions_of(flight, estimate, photos, placed)
    return [
        at_least("photos placed, of 75", int(placed.sum()), "", 74),
        at_most("connected components", int(estimate.component.max()) + 1, "", 1),
        *shape(positions),
        *against_gps(positions),
        *heights(positions),
        good_gps(flight, estimate, positions, placed),
        *beside_pycolmap(photos, took[0], estimate),
    ]


def positions_of(flight: Flight, estimate: Estimate, photos: Path, placed: NDArray[np.bool_]) -> Positions:
    """Positions of each photo: ours, the reference's and the GPS's."""
    rows = reference_of(photos)
    reference = np.array([rows[name] for name in estimate.frame_names])
    assert flight.gps is not None
    gps = flight.gps
    fixes = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, gps.altitude_m, origin_of(estimate))
    return Positions(estimate.w_T_b[placed, :3, 3], reference[placed], fixes[estimate.frame_index[placed]])


def reference_of(photos: Path) -> dict[str, list[float]]:
    """Return the position of each photograph by structure from motion, in metres."""
    with (photos / "sfm_reference.csv").open() as stream:
        return {row[0]: [float(x) for x in row[1:]] for row in list(csv.reader(stream))[1:]}


def origin_of(estimate: Estimate) -> GeoOrigin:
    """Return the georeferenced camera positions of the map."""
    assert estimate.origin is not None, "the map is not georeferenced"
    return estimate.origin


def shape(p: Positions) -> list[Metric]:
    """Return the errors against structure from motion after a similarity."""
    onto = umeyama(p.ours_m, p.reference_m, with_scale=True)
    off = onto.apply(p.ours_m) - p.reference_m
    tilt_deg = float(np.degrees(np.arccos(np.clip(onto.R[2, 2], -1, 1))))
    return [
        reported("RMS to sfm_reference.csv after a similarity", rms_length(off), "m", HELD_CENTER),
        reported("the same, horizontally", rms_length(off[:, :2]), "m"),
        reported("the same, vertically", rms_length(off[:, 2:]), "m"),
        reported("tilt of that reference against our level map", tilt_deg, "deg"),
    ]


def against_gps(p: Positions) -> list[Metric]:
    """Return our GPS residual and the reference's, without alignment and each after a similarity."""
    # The reference's origin is not recorded; its least squares put its mean on the GPS's mean.
    reference = p.reference_m + (p.gps_m - p.reference_m).mean(axis=0)
    stand = p.ours_m - p.gps_m, reference - p.gps_m
    fitted = tuple(aligned(q, p.gps_m).apply(q) - p.gps_m for q in (p.ours_m, reference))
    metrics = []
    for how, (ours, theirs) in (("without alignment", stand), ("each after a similarity", fitted)):
        for axes, name in ((slice(0, 2), "horizontal"), (slice(2, 3), "vertical"), (slice(0, 3), "3-D")):
            a, b = rms_length(ours[:, axes]), rms_length(theirs[:, axes])
            key, source = f"{name} GPS residual over the reference's, {how}", f"{a:.2f} m over {b:.2f} m"
            asked = name == "horizontal" and how == "without alignment"
            source += "; " + LEANS if how == "without alignment" and name == "vertical" else ""
            metrics.append(
                at_most(key, a / b, "x", 1.1, source) if asked else reported(key, a / b, "x", source)
            )
    level = leveled(p.ours_m, p.gps_m)
    return [*metrics, reported("horizontal GPS residual of a level map at its least", level, "m")]


def leveled(moving_m: Array, fixed_m: Array) -> float:
    """Return the horizontal residual after a planar similarity, the only freedom of a level map."""
    flat = np.array([1.0, 1.0, 0.0])
    return rms_length((aligned(moving_m * flat, fixed_m * flat).apply(moving_m * flat) - fixed_m)[:, :2])


def aligned(moving_m: Array, fixed_m: Array) -> Similarity:
    """Return the least-squares similarity."""
    return umeyama(moving_m, fixed_m, with_scale=True)


def heights(p: Positions) -> list[Metric]:
    """Return the range of heights after the climb by each source, which explains the vertical residual."""
    span = {name: float(np.ptp(q[CLIMB_PHOTOS:, 2])) for name, q in (("our map", p.ours_m), ("GPS", p.gps_m))}
    return [
        reported(f"range of heights after the first {CLIMB_PHOTOS} photos, {name}", value, "m")
        for name, value in span.items()
    ]


def good_gps(flight: Flight, estimate: Estimate, p: Positions, placed: NDArray[np.bool_]) -> Metric:
    """Return the residual to a GPS made of structure from motion's positions, tilted and noisy, without
    alignment."""
    rng = np.random.default_rng(0)
    onto = umeyama(p.reference_m, p.ours_m, with_scale=True)
    level = onto.apply(p.reference_m)
    heading = rng.uniform(0, 2 * np.pi)
    axis = np.radians(GOOD_GPS_TILT_DEG) * np.array([np.cos(heading), np.sin(heading), 0.0])
    middle = level.mean(axis=0)
    tilted = (level - middle) @ Rotation.from_rotvec(axis).as_matrix().T + middle
    noisy = tilted + rng.normal(0, GOOD_GPS_STD_M, tilted.shape)
    assert flight.frames is not None
    stamps_s = flight.frames.stamps_s[estimate.frame_index[placed]]
    gps = Gps(stamps_s, *geodetic_from_enu(noisy, origin_of(estimate)), (GOOD_GPS_STD_M,) * 3)
    flown = replace(flight, gps=gps)
    run = evaluate(optimize(flown), flown)
    return at_most(
        "residual to a good GPS, nothing aligned",
        run.ate_m.rmse,
        "m",
        1.0,
        f"sfm_reference.csv tilted by {GOOD_GPS_TILT_DEG:g} deg, {GOOD_GPS_STD_M:g} m of noise an axis "
        f"({GOOD_GPS_STD_M * np.sqrt(3):.2f} m in all)",
    )


def beside_pycolmap(photos: Path, took: Took, estimate: Estimate) -> list[Metric]:
    """Return pycolmap's time on the same photos in the same run, and the distances to its positions.

    It runs twice: with every pair compared, and at its best, both on the CPU with a free principal point.
    """
    ours = reported("our time, pictures to poses", took.seconds, "s", f"{took.cpu_s:.0f} s of processor time")
    names = sorted(path.name for path in photos.glob("*.jpg"))
    try:
        every = mapped(photos, names, Settings(PYCOLMAP_SIDE_PX, free_center=True))
        best = mapped(photos, names, at_its_best(FeatureConfig()))
    except Skipped as skipped:
        return [replace(ours, source=f"pycolmap's not taken: {skipped}")]
    return [
        at_most(
            "RMS to pycolmap with a free principal point after a similarity", apart_m(estimate, every), "m",
            0.15,
        ),
        reported("the same, to pycolmap at its best", apart_m(estimate, best), "m"),
        ours,
        reported(f"pycolmap's time, {PYCOLMAP_SIDE_PX} px, exhaustive matching, CPU", every.seconds, "s"),
        reported(
            "our time over pycolmap's", took.seconds / every.seconds, "x",
            f"{took.seconds:.0f} s over {every.seconds:.0f} s; it placed {len(every.c_T_w)} of {len(names)}",
        ),
        *against_best(took, best, len(names)),
    ]  # fmt: skip


def apart_m(estimate: Estimate, theirs: Mapped) -> float:
    """Return the RMS distance of pycolmap's positions from ours after a similarity."""
    both = [k for k, name in enumerate(estimate.frame_names) if name in theirs.c_T_w and estimate.placed[k]]
    center, mine = theirs.centers([estimate.frame_names[k] for k in both]), estimate.w_T_b[both, :3, 3]
    return rms_length(umeyama(center, mine, with_scale=True).apply(center) - mine)
