"""32 photographs with RTK positions over concrete beams and trees, beside pycolmap.

The positions are measurements of the map too. So the map is made once more with every second of them, and
compared with the others.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.flight import Flight, Gps
from slam.core.geodesy import enu_from_geodetic
from slam.evaluation.trajectory import umeyama
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from tests.benchmarks.by_pycolmap import mapped
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most, reported, within

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
    began = time.perf_counter()
    flight = import_photos(photos)
    estimate = optimize(flight)
    seconds = time.perf_counter() - began
    metrics = [
        at_least("photos placed, of 32", int(estimate.placed.sum()), "", 32),
        at_most("positions against RTK, nothing aligned", rms(off_m(flight, estimate)), "m", WANTED_M),
        *held_out(flight),
        reported("our time, pictures to poses", seconds, "s"),
    ]
    return [*metrics, *beside_pycolmap(photos, flight, estimate, seconds)]


def off_m(flight: Flight, estimate: Estimate) -> Array:
    """Return (n, 3) differences of all keyframes' positions from the flight's, in metres."""
    assert flight.gps is not None
    assert flight.frames is not None
    assert estimate.origin is not None
    gps = flight.gps
    fixes = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, gps.altitude_m, estimate.origin)
    at = np.searchsorted(gps.stamps_s, flight.frames.stamps_s[estimate.frame_index])
    return np.asarray(estimate.w_T_b[:, :3, 3] - fixes[at])


def held_out(flight: Flight) -> list[Metric]:
    """Map with every second position, and compare with the others."""
    assert flight.gps is not None
    assert flight.frames is not None
    used = np.arange(len(flight.gps.stamps_s)) % 2 == 0
    estimate = optimize(replace(flight, gps=some(flight.gps, used)))
    others = ~np.isin(flight.frames.stamps_s[estimate.frame_index], flight.gps.stamps_s[used])
    off = off_m(flight, estimate)[others]
    R = estimate.w_T_b[others, :3, :3]
    told = R @ estimate.covariances[others, 3:, 3:] @ np.swapaxes(R, 1, 2)
    own = np.diag(np.array(flight.gps.noise_std_m) ** 2)
    nees = np.einsum("na,na->n", off, np.linalg.solve(told + own, off[..., None])[..., 0]) / 3
    count = f"{len(off)} positions that the map does not use"
    return [
        at_most("position error at RTK fixes that the map does not use", rms(off), "m", WANTED_M, count),
        reported("the same, horizontally", rms(off[:, :2]), "m"),
        reported("the same, vertically", rms(off[:, 2:]), "m"),
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


def beside_pycolmap(photos: Path, flight: Flight, estimate: Estimate, seconds: float) -> list[Metric]:
    """Return pycolmap's errors after a similarity, with a free principal point, and its time."""
    names = sorted(path.name for path in photos.glob("*.JPG"))
    try:
        theirs = mapped(photos, names, PYCOLMAP_SIDE_PX, free_center=True)
    except Skipped as skipped:
        return [reported("pycolmap", float("nan"), "", f"not taken: {skipped}")]
    truth = estimate.w_T_b[:, :3, 3] - off_m(flight, estimate)
    poses = [theirs.c_T_w.get(Path(name).name) for name in estimate.frame_names]
    placed = np.array([pose is not None for pose in poses])
    center = np.array([-pose[:, :3].T @ pose[:, 3] for pose in poses if pose is not None])
    onto = umeyama(center, truth[placed], with_scale=True)
    ours = umeyama(estimate.w_T_b[:, :3, 3], truth, with_scale=True)
    aligned = rms(ours.apply(estimate.w_T_b[:, :3, 3]) - truth)
    how = f"{PYCOLMAP_SIDE_PX} px, OPENCV lens, free principal point, exhaustive matching, CPU"
    took = f"it took {theirs.seconds:.0f} s"
    return [
        reported("ours after a similarity", aligned, "m"),
        reported("pycolmap's after a similarity", rms(onto.apply(center) - truth[placed]), "m", how),
        reported("photos that pycolmap placed", int(placed.sum()), ""),
        reported("time over pycolmap's", seconds / theirs.seconds, "x", took),
    ]


def rms(off_m: Array) -> float:
    """Return the root mean square length of (n, d) differences."""
    return float(np.sqrt(np.mean(np.sum(off_m**2, axis=1))))
