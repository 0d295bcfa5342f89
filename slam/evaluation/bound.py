"""Cramer-Rao bound of the map of a simulated flight, given its measurements.

The bound is for the front end's output, not for the pictures: the floor points that it followed and the
keyframes that observed them. Noise is the difference of a measurement from the truth. The information is
evaluated at the truth, with measurements placed there. No residual is large, so no loss is robust and the
bound is that of a Gaussian. Source: Kay 1993, Fundamentals of Statistical Signal Processing: Estimation
Theory, chapter 3.

The errors of a flight are few and of long wavelength. On the figure eight one number, the scale that the
ranges determine, is four fifths of the expected squared error. The ratio of error to bound therefore
scatters, with ``effective_freedom`` degrees of freedom a flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backend.bundle.floor_points import intersect_floor
from backend.bundle.information import Information, information
from backend.bundle.lens import start_numbers
from backend.bundle.noise import start_noise, track_correlation_factor
from backend.bundle.problem import BundleConfig, NoiseLevels
from backend.bundle.projections import residuals
from backend.bundle.refinement import refine
from backend.bundle.residual_spread import huber_std
from backend.measurements import FloorTracks, Measurements, PinholeModel
from frontend.mosaic.quality import ground_jacobian
from frontend.tracks import join_tracks
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.rotations import roll_pitch_yaw_of
from slam.evaluation.association import poses_at
from slam.evaluation.landmarks import seen_at
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.part_measurements import part_measurements
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_LEVEL = 2e-4
"""Relief over the mean height of a floor without relief: the lower limit of the refinement."""


@dataclass(frozen=True)
class Bound:
    """Lower bound of the errors of any unbiased estimate of the keyframes, in the gauge of the first one."""

    keyframes: NDArray[np.int64]
    """(n,) numbers of the keyframes of the largest part."""
    w_T_b: Array
    """(n, 4, 4) true poses."""
    covariances: Array
    """(n, 6, 6) covariances, rotation first, right perturbation, given the first pose's position and
    heading."""
    noise: NoiseLevels
    """Noise of the measurements: their differences from the truth."""
    information: Information
    measured: Measurements
    """The measurements with these noise levels, without the floor points that are outliers."""

    @property
    def position_rmse_m(self) -> float:
        """Expected root mean square of the position errors, in metres; compare it with ``ate_m``."""
        return float(np.sqrt(np.trace(self.covariances[:, 3:, 3:], axis1=1, axis2=2).mean()))

    @cached_property
    def position_covariance_m2(self) -> Array:
        """(3n, 3n) covariance of all positions together, in world axes, in the gauge of the first one."""
        n = len(self.w_T_b)
        gradient = np.zeros((n, 3, n, 6))
        gradient[np.arange(n), :, np.arange(n), 3:] = self.w_T_b[:, :3, :3]
        gradient[:, :, 0, 3:] -= self.w_T_b[0, :3, :3]
        return self.information.covariance(gradient.reshape(3 * n, n, 6))

    @property
    def effective_freedom(self) -> float:
        """Number of independent terms of equal variance that scatter as the mean squared position error does.

        Source: Satterthwaite 1946, An approximate distribution of estimates of variance components.
        """
        C = self.position_covariance_m2
        return float(np.trace(C) ** 2 / np.sum(C**2))

    def distance_std_m(self, flight: Flight, a: str, b: str) -> float:
        """Standard deviation of the distance between two landmarks as the evaluation measures it on the map.

        NaN where one of them is not seen.
        """
        toward = flight.landmarks[b] - flight.landmarks[a]
        toward = toward / np.linalg.norm(toward)
        gradient = sum(
            sign * np.einsum("c,mca->ma", toward, self._place_gradient(flight, name))
            for sign, name in ((-1, a), (1, b))
        )
        return float(np.sqrt(self.information.covariance(np.asarray(gradient)[None])[0, 0]))

    def _place_gradient(self, flight: Flight, name: str) -> Array:
        """Gradient (n, 3, 6) of a landmark's mean position by the keyframes that see it. Source: derived."""
        assert flight.camera is not None
        w_p = flight.landmarks[name]
        k = np.flatnonzero(seen_at(flight.camera, self.w_T_b, w_p)[1])
        gradient = np.full((len(self.w_T_b), 3, 6), 0.0 if len(k) else np.nan)
        for pose, row in zip(self.w_T_b[k], k, strict=True):
            J = ground_jacobian(w_p, (pose @ flight.camera.b_T_c)[:3, 3], pose[:3, 3])
            gradient[row, :2] = J @ np.kron(np.eye(2), pose[:3, :3]) / len(k)
        return gradient


def cramer_rao(
    flight: Flight, estimate: Estimate, observations: Observations, config: PipelineConfig = PipelineConfig()
) -> Bound:
    """Compute the bound of a flight with truth over a level floor, from ``optimize_with_observations``.

    Raises ``InputError`` where the flight has no truth or camera, and ``BackendError`` where keyframes share
    too few floor points.
    """
    if flight.truth is None or flight.camera is None:
        raise InputError(f"{flight.name}: the bound of a flight needs its truth and a camera; simulate one")
    readings = KeyframeReadings.at(flight, observations.stamps_s, flight.geo_origin(), config)
    setup = Setup(flight.camera, readings, config)
    pairs = {(edge.i, edge.j) for edge in estimate.relative_poses}
    kept = [r for r in observations.registrations if (r.i, r.j) in pairs]
    members = np.flatnonzero(estimate.component == 0)
    tracks = join_tracks(observations.store.points, kept, flight.camera, config.tracks)
    measured = part_measurements(setup, members, tracks)
    w_T_b = poses_at(flight.truth, observations.stamps_s[members])
    ideal, as_measured, noise = at_the_truth(measured, w_T_b, config.bundle)
    there = replace(config.bundle, rounds=1, start_relief=noise.relief)
    found = refine(ideal, w_T_b, 0.0, there)
    return Bound(members, w_T_b, found.covariances, noise, information(ideal, w_T_b, there), as_measured)


def at_the_truth(
    measured: Measurements, w_T_b: Array, config: BundleConfig
) -> tuple[Measurements, Measurements, NoiseLevels]:
    """Return noise-free measurements of true poses (n, 4, 4), the recorded ones, and the noise.

    The two sets of measurements carry the noise levels that were found. Both leave out floor points that are
    outliers, and the barometer, which tells little of where a camera is.
    """
    measured = replace(measured, heights=())
    tracks, camera = measured.tracks, measured.camera
    assert tracks is not None
    assert camera is not None
    for _ in range(config.rounds):
        pixel = _on_the_floor(tracks, camera, w_T_b)
        off = (tracks.pixel - pixel) / tracks.std_px[:, None]
        # The residuals lose two degrees of freedom a point: its fitted position.
        fitted = np.sqrt(len(off) / (len(off) - len(np.unique(tracks.track))))
        spread = huber_std(off, config.huber_sigmas) * float(fitted)
        tracks = _near(tracks, off, config.drop_sigmas * max(1.0, spread))
    pixel = _on_the_floor(tracks, camera, w_T_b)
    off = (tracks.pixel - pixel) / tracks.std_px[:, None]
    colour = track_correlation_factor(tracks, off, np.ones(len(off), dtype=bool))
    ideal = _instruments_at_the_truth(measured, w_T_b)
    noise = replace(
        start_noise(measured, config),
        pixel_scale=spread * float(np.sqrt(colour)),
        relief=_LEVEL,
        roll_pitch_rad=_off(measured, ideal, "attitudes"),
        range_m=_off(measured, ideal, "ranges"),
    )
    tracks = replace(tracks, std_px=tracks.std_px * noise.pixel_scale)
    as_measured = _with_noise(replace(measured, tracks=tracks), noise)
    return _with_noise(replace(ideal, tracks=replace(tracks, pixel=pixel)), noise), as_measured, noise


def _near(tracks: FloorTracks, off: Array, limit: float) -> FloorTracks:
    near = np.linalg.norm(off, axis=1) < limit
    near &= np.bincount(tracks.track, near)[tracks.track] >= 2
    track = np.unique(tracks.track[near], return_inverse=True)[1]
    return FloorTracks(tracks.keyframe[near], track, tracks.pixel[near], tracks.std_px[near])


def _on_the_floor(tracks: FloorTracks, camera: PinholeModel, w_T_b: Array) -> Array:
    """Pixels (m, 2) of the observations if each point were at the mean of where its rays meet the floor."""
    w_T_c = w_T_b @ camera.b_T_c
    point, origin = intersect_floor(tracks, camera, w_T_c), np.zeros_like(tracks.pixel)
    seen = tracks.keyframe, tracks.track, origin
    return np.asarray(residuals(w_T_c, point, start_numbers(camera), *seen))


def _with_noise(measured: Measurements, noise: NoiseLevels) -> Measurements:
    tilt = np.full(2, noise.roll_pitch_rad)
    return replace(
        measured,
        attitudes=tuple(replace(a, std_rad=np.append(tilt, a.std_rad[2])) for a in measured.attitudes),
        ranges=tuple(replace(r, std_m=noise.range_m) for r in measured.ranges),
    )


def _instruments_at_the_truth(measured: Measurements, w_T_b: Array) -> Measurements:
    turned = roll_pitch_yaw_of(w_T_b[:, :3, :3])
    w_T_s = np.array([w_T_b[r.k] @ r.b_T_s for r in measured.ranges]).reshape(-1, 4, 4)
    slant = w_T_s[:, 2, 3] / w_T_s[:, 2, 2]
    return replace(
        measured,
        attitudes=tuple(replace(a, roll_pitch_yaw_rad=turned[a.k]) for a in measured.attitudes),
        ranges=tuple(replace(r, range_m=float(m)) for r, m in zip(measured.ranges, slant, strict=True)),
    )


def _off(measured: Measurements, ideal: Measurements, kind: Literal["attitudes", "ranges"]) -> float:
    """Root mean square of an instrument's error; infinite without readings."""
    if kind == "attitudes":
        pairs = zip(measured.attitudes, ideal.attitudes, strict=True)
        off = [a.roll_pitch_yaw_rad[:2] - b.roll_pitch_yaw_rad[:2] for a, b in pairs]
    else:
        off = [np.array([a.range_m - b.range_m]) for a, b in zip(measured.ranges, ideal.ranges, strict=True)]
    return float(np.sqrt(np.mean(np.square(off)))) if off else np.inf
