"""32 photographs with RTK positions over concrete beams and trees, beside pycolmap.

The positions are measurements of the map too. So the map is made once more with every second of them, and
compared with the others.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.features import FeatureConfig
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.streams import Gps
from slam.evaluation.trajectory import umeyama
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from tests.benchmarks.apart import Took, timed
from tests.benchmarks.by_pycolmap import Mapped, Settings, against_best, at_its_best, mapped
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most, reported, rms_length, within

Array = NDArray[np.float64]

WANTED_M = 0.06
NEES_BAND = 0.42, 1.83
"""Sixteen held-out positions of one map are not independent: the band is that of five times three values;
their mean lies between 0.42 and 1.83 with a probability of 95 %.
"""
PYCOLMAP_SIDE_PX = 1000


def measure() -> list[Metric]:
    """Return all figures, without pycolmap's where the package is missing."""
    photos = folder("photos/isfm")
    with timed() as took:
        flight = import_photos(photos)
        estimate = optimize(flight)
    metrics = [
        at_least("photos placed, of 32", int(estimate.placed.sum()), "", 32),
        at_most("positions against RTK, nothing aligned", rms_length(off_m(flight, estimate)), "m", WANTED_M),
        *held_out(flight),
        reported("our time, pictures to poses", took[0].seconds, "s"),
    ]
    return [*metrics, *beside_pycolmap(photos, flight, estimate, took[0])]


def off_m(flight: Flight, estimate: Estimate) -> Array:
    """Return (n, 3) differences of the antenna's positions at all keyframes from the flight's, in metres."""
    assert flight.gps is not None
    assert flight.frames is not None
    assert estimate.origin is not None
    gps = flight.gps
    fixes = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, gps.altitude_m, estimate.origin)
    at = np.searchsorted(gps.stamps_s, flight.frames.stamps_s[estimate.frame_index])
    return np.asarray(antenna_positions_m(estimate) - fixes[at])


def antenna_positions_m(estimate: Estimate) -> Array:
    """Return the positions (n, 3) of the antenna, which are those that RTK measures."""
    assert estimate.antenna_m is not None
    return np.asarray(estimate.w_T_b[:, :3, 3] + estimate.w_T_b[:, :3, :3] @ estimate.antenna_m)


def antenna_covariances(estimate: Estimate) -> Array:
    """Return the covariances (n, 3, 3) of the antenna's positions in the axes of the world."""
    if estimate.antenna_covariances is not None:
        return estimate.antenna_covariances
    R = estimate.w_T_b[:, :3, :3]
    return np.asarray(R @ estimate.covariances[:, 3:, 3:] @ np.swapaxes(R, 1, 2))


def held_out(flight: Flight) -> list[Metric]:
    """Map with every second position, and compare with the others."""
    assert flight.gps is not None
    assert flight.frames is not None
    used = np.arange(len(flight.gps.stamps_s)) % 2 == 0
    estimate = optimize(replace(flight, gps=some(flight.gps, used)))
    others = ~np.isin(flight.frames.stamps_s[estimate.frame_index], flight.gps.stamps_s[used])
    off = off_m(flight, estimate)[others]
    told = antenna_covariances(estimate)[others]
    own = np.diag(np.array(flight.gps.noise_std_m) ** 2)
    nees = np.einsum("na,na->n", off, np.linalg.solve(told + own, off[..., None])[..., 0]) / 3
    count = f"{len(off)} positions that the map does not use"
    return [
        at_most(
            "position error at RTK fixes that the map does not use", rms_length(off), "m", WANTED_M, count
        ),
        reported("the same, horizontally", rms_length(off[:, :2]), "m"),
        reported("the same, vertically", rms_length(off[:, 2:]), "m"),
        within("their squared errors over the told and the receiver's variances", nees.mean(), "", NEES_BAND),
    ]


def some(gps: Gps, which: NDArray[np.bool_]) -> Gps:
    """Return the fixes for which ``which`` (k,) is true."""
    return replace(
        gps,
        stamps_s=gps.stamps_s[which],
        latitude_deg=gps.latitude_deg[which],
        longitude_deg=gps.longitude_deg[which],
        altitude_m=gps.altitude_m[which],
    )


def beside_pycolmap(photos: Path, flight: Flight, estimate: Estimate, took: Took) -> list[Metric]:
    """Return pycolmap's errors after a similarity, with a free principal point, and its times.

    It runs twice: with every pair compared, and at its best.
    """
    names = sorted(path.name for path in photos.glob("*.JPG"))
    try:
        every = mapped(photos, names, Settings(PYCOLMAP_SIDE_PX, free_center=True))
        best = mapped(photos, names, at_its_best(FeatureConfig()))
    except Skipped as skipped:
        return [reported("pycolmap", float("nan"), "", f"not taken: {skipped}")]
    truth = estimate.w_T_b[:, :3, 3] - off_m(flight, estimate)
    ours = umeyama(estimate.w_T_b[:, :3, 3], truth, with_scale=True)
    aligned = rms_length(ours.apply(estimate.w_T_b[:, :3, 3]) - truth)
    how = f"{PYCOLMAP_SIDE_PX} px, OPENCV lens, free principal point, exhaustive matching, CPU"
    return [
        reported("ours after a similarity", aligned, "m"),
        reported("pycolmap's after a similarity", error_m(estimate, truth, every), "m", how),
        reported("the same, pycolmap at its best", error_m(estimate, truth, best), "m"),
        reported("photos that pycolmap placed", len(every.c_T_w), ""),
        reported("time over pycolmap's", took.seconds / every.seconds, "x", f"it took {every.seconds:.0f} s"),
        *against_best(took, best, len(names)),
    ]


def error_m(estimate: Estimate, truth: Array, theirs: Mapped) -> float:
    """Return the RMS distance of pycolmap's positions from the true ones (n, 3) after a similarity."""
    names = [Path(name).name for name in estimate.frame_names]
    placed = np.array([name in theirs.c_T_w for name in names])
    center = theirs.centers([name for name in names if name in theirs.c_T_w])
    return rms_length(umeyama(center, truth[placed], with_scale=True).apply(center) - truth[placed])
