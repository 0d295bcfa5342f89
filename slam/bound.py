"""How good a map of a simulated flight could be: the Cramer-Rao bound of what was measured.

Not of the pictures, but of what the front end took from them: which floor points it followed through which
keyframes. Noise is what the residuals at the truth show. The information is taken at the truth, with
measurements put there: nothing is far off, so that no loss is robust and the bound is a Gaussian's.
Source: Kay 1993, Fundamentals of Statistical Signal Processing: Estimation Theory, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.graph import BundleConfig, BundleProblem, NoiseLevels, start_values
from backend.bundle.noise import estimate_noise, start_noise
from backend.bundle.refinement import refine
from backend.measurements import FloorTracks, Measurements
from slam.errors import InputError
from slam.estimate import Estimate
from slam.evaluation.association import poses_at
from slam.flight import Flight
from slam.mapping.mapper import Mapper, Sensors
from slam.mapping.sightings import Sightings
from slam.settings import PipelineConfig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bound:
    """What no unbiased estimate of the keyframes can do better than, in the gauge of the first one."""

    keyframes: NDArray[np.int64]
    """(n,) numbers of the keyframes of the largest part."""
    w_T_b: Array
    """(n, 4, 4) where they truly are."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation, given the first one's position and heading."""
    noise: NoiseLevels
    """As the residuals at the truth show it."""

    @property
    def position_rmse_m(self) -> float:
        """Root mean square of the position errors to be expected, to be held against ``ate_m``."""
        return float(np.sqrt(np.trace(self.covariances[:, 3:, 3:], axis1=1, axis2=2).mean()))


def cramer_rao(
    flight: Flight, estimate: Estimate, sightings: Sightings, config: PipelineConfig = PipelineConfig()
) -> Bound:
    """The bound of a flight over a level floor with truth, from what ``optimize_with_sightings`` gives.

    Raises ``InputError`` where the flight has no truth or camera, and ``BackendError`` where keyframes share
    too few floor points.
    """
    if flight.truth is None or flight.camera is None:
        raise InputError(f"{flight.name}: the bound of a flight needs its truth and a camera; simulate one")
    mapper = Mapper(
        flight.camera, Sensors.at(flight, sightings.stamps_s, flight.geo_origin(), config), config
    )
    pairs = {(edge.i, edge.j) for edge in estimate.relative_poses}
    kept = [r for r in sightings.registrations if (r.i, r.j) in pairs]
    members = np.flatnonzero(estimate.component == 0)
    measured = mapper.measured(members, mapper.tracks(sightings.store.pixels, kept))
    w_T_b = poses_at(flight.truth, sightings.stamps_s[members])
    ideal, noise = at_the_truth(measured, w_T_b, config.bundle)
    found = refine(ideal, w_T_b, 0.0, replace(config.bundle, rounds=1, start_relief=noise.relief))
    return Bound(members, w_T_b, found.covariances, noise)


def at_the_truth(
    measured: Measurements, w_T_b: Array, config: BundleConfig
) -> tuple[Measurements, NoiseLevels]:
    """What would have been measured of true poses (n, 4, 4) without noise, with the noise that there was."""
    tracks, camera = measured.tracks, measured.camera
    assert tracks is not None
    assert camera is not None
    problem = BundleProblem(measured, tracks, camera, config, calibrates=False)
    values = start_values(problem, w_T_b, 0.0)
    noise, used = start_noise(measured, config), np.ones(len(tracks.track), dtype=bool)
    for _ in range(config.rounds - 1):
        noise, used = estimate_noise(problem, values, noise, used)
    ideal = _instruments_at_the_truth(measured, w_T_b)
    noise = replace(
        noise, roll_pitch_rad=_off(measured, ideal, "attitudes"), range_m=_off(measured, ideal, "ranges")
    )
    w_T_c = (w_T_b @ camera.b_T_c)[tracks.keyframe[used]]
    track = np.unique(tracks.track[used], return_inverse=True)[1]
    ray = np.column_stack(
        [(tracks.pixel[used] - camera.center_px) / camera.focal_px, np.ones(int(used.sum()))]
    )
    ray = np.einsum("mab,mb->ma", w_T_c[:, :3, :3], ray)
    hit = w_T_c[:, :3, 3] - (w_T_c[:, 2, 3] / ray[:, 2])[:, None] * ray
    seen = np.bincount(track)
    point = np.column_stack([np.bincount(track, hit[:, axis]) / seen for axis in range(3)])[track]
    c_p = np.einsum("mba,mb->ma", w_T_c[:, :3, :3], point - w_T_c[:, :3, 3])
    pixel = c_p[:, :2] / c_p[:, 2:] * camera.focal_px + camera.center_px
    tilt = np.full(2, noise.roll_pitch_rad)
    ideal = replace(
        ideal,
        tracks=FloorTracks(tracks.keyframe[used], track, pixel, tracks.std_px[used] * noise.pixel_scale),
        attitudes=tuple(replace(a, std_rad=np.append(tilt, a.std_rad[2])) for a in ideal.attitudes),
        ranges=tuple(replace(r, std_m=noise.range_m) for r in ideal.ranges),
    )
    return ideal, noise


def _instruments_at_the_truth(measured: Measurements, w_T_b: Array) -> Measurements:
    turned = Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")[:, ::-1]
    slant = w_T_b[:, 2, 3] / w_T_b[:, 2, 2]
    return replace(
        measured,
        attitudes=tuple(replace(a, roll_pitch_yaw_rad=turned[a.k]) for a in measured.attitudes),
        ranges=tuple(replace(r, range_m=float(slant[r.k])) for r in measured.ranges),
    )


def _off(measured: Measurements, ideal: Measurements, kind: Literal["attitudes", "ranges"]) -> float:
    """Root mean square of what an instrument was off; infinite where there is none."""
    if kind == "attitudes":
        pairs = zip(measured.attitudes, ideal.attitudes, strict=True)
        off = [a.roll_pitch_yaw_rad[:2] - b.roll_pitch_yaw_rad[:2] for a, b in pairs]
    else:
        off = [np.array([a.range_m - b.range_m]) for a, b in zip(measured.ranges, ideal.ranges, strict=True)]
    return float(np.sqrt(np.mean(np.square(off)))) if off else np.inf
