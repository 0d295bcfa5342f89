"""Score and information of the matches between pictures, given the path from all other instruments.

A match's residual r = pixel_i - transferred(pixel_j) has its own noise W^-1 and, through the two poses, the
path's covariance S: r ~ N(C d, W^-1 + B S B'). With S = L L' and M = B' W B the poses are marginalised
exactly, V^-1 = W - W B L (I + L' M L)^-1 L' B' W, and V itself is never formed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.sparse import csr_array

from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.camera.camera_path import CameraPath, camera_path
from slam.criticism.camera.lens import NUDGE, WARP_TOLERANCE, floor_of, pixels_of, warp
from slam.criticism.camera.photometric import PICTURE_PATTERNS, photometric_score
from slam.criticism.cause import NOT_AHEAD_S, ChannelError
from slam.criticism.kalman.filter_parameters import CAMERA, OFFSET, POINTS, READOUT, FilterParameters
from slam.criticism.kalman.kernel_inputs import LikelihoodScore, Perturbation
from slam.criticism.kalman.readings import SENSOR, SLOPE_X, SLOPE_Y
from slam.criticism.kalman.record import Record
from slam.data_quality.pictures.feature_matches import FeatureMatches

_POSE_NUDGE = 1e-5
_SLOPE_NUDGE = 1e-4
_PRIOR = 1e-4
"""Information added to sizes that a flight may not show, since a matrix of zeros cannot be inverted."""
TOLERANCE = np.concatenate([[2e-3, 3e-3, 3e-4, 3e-4, 3e-4, 1e-4, 3e-5], WARP_TOLERANCE])
"""Largest apparent error of a healthy camera by features on small pictures, of its clock, and of warps."""
_PIXEL_NUDGE = 0.1
"""Step in pixels to either side of a central difference."""
MISMATCH, MISMATCH_Z = 0.25, 5.0
"""Least error of a mismatched pair in picture widths, beyond so many standard deviations of the path. No
camera error of the catalogue displaces a picture by a quarter."""
MOST_MISMATCHED = 0.1
"""Greatest share of the pairs; with more of them the path or the camera model is wrong."""


def reprojection_score(
    record: Record, matches: FeatureMatches, parameters: FilterParameters,
    directions: Sequence[Perturbation], path: CameraPath | None = None,
) -> LikelihoodScore:  # fmt: skip
    """Return score and information of the perturbations, 0 for those that pictures cannot show.

    Only the pictures on the ``path`` count; without a path, all do.
    """
    along = camera_path(record, matches, parameters) if path is None else path
    prior = [_PRIOR if d.kind in ("camera", "picture") else 0.0 for d in directions]
    return (
        _points(_Scene.of(matches, parameters, along), directions)
        + photometric_score(matches, parameters.camera, along, directions)
        + LikelihoodScore(np.diag(prior), np.zeros(len(directions)))
    )


def _points(scene: _Scene, directions: Sequence[Perturbation]) -> LikelihoodScore:
    """Return the score of the positions of points."""
    path = scene.path
    if not len(scene.i):
        return LikelihoodScore.nothing(len(directions))
    B = scene.by_pose()
    C = np.zeros((len(scene.i), 2, len(directions) + len(TOLERANCE)))
    moving = [k for k, d in enumerate(directions) if d.kind == "sensor"]
    entries = [directions[k].entry for k in moving]
    traces = path.sensitivity.reshape(len(path.times_s), 6, len(SENSOR))[:, :, entries]
    C[:, :, moving] = np.matmul(B[:, :, :6], traces[scene.i]) + np.matmul(B[:, :, 6:], traces[scene.j])
    by_camera = scene.by_camera()
    when = 0.5 * (path.times_s[scene.i] + path.times_s[scene.j])
    fast = -when[:, None] * by_camera[:, :, OFFSET]
    warped = scene.by_warp()
    C[:, :, len(directions) :] = np.concatenate([by_camera, fast[:, :, None], warped], axis=2)
    for k, d in enumerate(directions):
        if d.kind == "camera" and d.entry < POINTS:
            C[:, :, k] = by_camera[:, :, d.entry]
        elif d.kind == "picture" and d.entry >= len(PICTURE_PATTERNS):
            C[:, :, k] = warped[:, :, d.entry - len(PICTURE_PATTERNS)]
        elif d.kind == "drift":
            C[:, :, k] = fast
        elif d.kind == "sensor" and d.entry in (SLOPE_X, SLOPE_Y):
            C[:, :, k] += scene.by_slope(d.entry - SLOPE_X)
    return _marginal(scene, B, C, path.covariance)


def _marginal(scene: _Scene, B: Array, C: Array, covariance: Array) -> LikelihoodScore:
    """Marginalise the poses with the path's covariance, and the camera with its tolerance."""
    n, rows = len(covariance) // 6, 2 * len(scene.i)
    right = np.concatenate([C, scene.off()[:, :, None]], axis=2)
    weight = 1.0 / scene.std
    right, B = right * weight[:, None, None], B * weight[:, None, None]
    M = np.zeros((n * n, 36))
    blocks = np.matmul(B.transpose(0, 2, 1), B)
    for p, a in ((scene.i, 0), (scene.j, 6)):
        for q, b in ((scene.i, 0), (scene.j, 6)):
            M += _summed(p * n + q, n * n, blocks[:, a : a + 6, b : b + 6])
    shares = np.matmul(B.transpose(0, 2, 1), right)
    across = _summed(scene.i, n, shares[:, :6]) + _summed(scene.j, n, shares[:, 6:])
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / scale[:, None] / scale + 1e-10 * np.eye(6 * n)
    L = scale[:, None] * cholesky(correlation, lower=True, check_finite=False)
    inner = L.T @ M.reshape(n, n, 6, 6).transpose(0, 2, 1, 3).reshape(6 * n, 6 * n) @ L
    inner[np.arange(6 * n), np.arange(6 * n)] += 1.0
    factor = cho_factor(inner, lower=True, check_finite=False)
    seen = L.T @ across.reshape(6 * n, -1)
    flat = right.reshape(rows, -1)
    left = flat.T @ flat - seen.T @ cho_solve(factor, seen)
    log_det = 2.0 * float(np.log(np.diag(factor[0])).sum() + 2.0 * np.log(scene.std).sum())
    count = C.shape[2] - len(TOLERANCE)
    own = np.append(np.arange(count), C.shape[2])
    loose = np.arange(count, C.shape[2])
    std = TOLERANCE.copy()
    # Makers differ in the row that a stamp refers to.
    std[OFFSET] += 0.5 * abs(scene.parameters.camera[READOUT])
    tolerance = left[np.ix_(loose, loose)] + np.diag(1.0 / std**2)
    taken = np.linalg.solve(tolerance, left[np.ix_(loose, own)])
    left = left[np.ix_(own, own)] - left[np.ix_(own, loose)] @ taken
    log_det += float(np.linalg.slogdet(tolerance * std * std[:, None])[1])
    chi_square = float(left[-1, -1])
    return LikelihoodScore(left[:-1, :-1], left[:-1, -1], -0.5 * (chi_square + log_det), chi_square, rows)


def _summed(row: Ints, count: int, values: Array) -> Array:
    """Return (count, ...) sums of the values (m, ...) with the same row, each flattened."""
    m = len(row)
    place = csr_array((np.ones(m), (row, np.arange(m))), shape=(count, m))
    return np.asarray(place @ values.reshape(m, -1))


@dataclass(frozen=True)
class _Scene:
    """Matches with the poses of their pictures."""

    matches: FeatureMatches
    parameters: FilterParameters
    path: CameraPath
    i: Ints
    """(m,) index into the path."""
    j: Ints
    seen: Array
    """(m, 2) pixels in picture i."""
    other: Array
    """(m, 2) pixels in picture j."""
    std: Array
    earlier: Ints
    """(m,) index of the pair's earlier picture among all pictures."""

    @staticmethod
    def of(matches: FeatureMatches, parameters: FilterParameters, along: CameraPath) -> _Scene:
        """Return the matches inside the path. Every other match is transferred from the earlier picture into
        the later one, the rest from the later into the earlier.

        The noise of a transferred point is in the derivatives too. As in any regression on noisy values, this
        shrinks the estimated scale: by 10^-5 a pair, which adds up to a drift of the height. The two
        directions of transfer cancel it.
        """
        kept = along.holds(matches.earlier, matches.later)
        picture = np.stack([along.index(matches.earlier[kept]), along.index(matches.later[kept])])
        pixel = np.stack([matches.pixel_i[kept], matches.pixel_j[kept]])
        for both in (picture, pixel):
            both[:, 1::2] = both[::-1, 1::2].copy()
        (i, j), (seen, other) = picture, pixel
        own = matches.std_px[kept], matches.earlier[kept]
        return _Scene(matches, parameters, along, i, j, seen, other, *own)

    def transferred(
        self, camera: Array | None = None, slope: Array | None = None, at_i: float | Array = 0.0,
        at_j: float | Array = 0.0, off_j: float | Array = 0.0,
    ) -> Array:  # fmt: skip
        """Return (m, 2) pixels j transferred into picture i, with the given quantities changed."""
        nominal, camera = self.matches.camera, self.parameters.camera if camera is None else camera
        slope = self.parameters.sensor[[SLOPE_X, SLOPE_Y]] if slope is None else slope
        pose_i, pose_j = self._poses(camera, self.i, self.seen), self._poses(camera, self.j, self.other)
        floor = floor_of(nominal, camera, pose_j + at_j, self.other + off_j, slope)
        return pixels_of(nominal, camera, pose_i + at_i, floor)

    def off(self) -> Array:
        """Return (m, 2) residuals in px."""
        return np.asarray(self.seen - self.transferred())

    def _poses(self, camera: Array, picture: Ints, pixel: Array) -> Array:
        """Return (m, 6) poses at the time of each pixel's row; the path is sampled at the middle row's."""
        late = camera[READOUT] * (pixel[:, 1] / (self.matches.camera.size_px[1] - 1) - 0.5)
        shift = (late - camera[OFFSET] + self.parameters.camera[OFFSET])[:, None]
        rate = self.path.rates[picture] + shift * (0.5 * self.path.accelerations[picture])
        return np.asarray(self.path.poses[picture] + shift * rate)

    def by_pose(self) -> Array:
        """Return (m, 2, 12) derivatives in pose i and pose j."""
        steps = _POSE_NUDGE * np.eye(6)
        return np.concatenate([self._slopes("at_i", 0.0, steps), self._slopes("at_j", 0.0, steps)], axis=2)

    def by_camera(self) -> Array:
        """Return (m, 2, ``POINTS``) derivatives in the camera's vector."""
        return self._slopes("camera", self.parameters.camera, NUDGE[:, None] * np.eye(POINTS, len(CAMERA)))

    def by_slope(self, axis: int) -> Array:
        """Return (m, 2) derivatives in the floor's slope along x or y, for a fixed path."""
        slope = self.parameters.sensor[[SLOPE_X, SLOPE_Y]]
        return self._slopes("slope", slope, _SLOPE_NUDGE * np.eye(2)[axis : axis + 1])[:, :, 0]

    def _slopes(self, quantity: str, at: float | Array, steps: Array) -> Array:
        """Return (m, 2, k) derivatives of the transferred pixels in a quantity about its value ``at``, by
        central differences with steps (k, entries), each of one entry."""
        slopes = np.empty((len(self.i), 2, len(steps)))
        for k, step in enumerate(steps):
            sides = [self.transferred(**{quantity: at + side * step}) for side in (1.0, -1.0)]
            slopes[:, :, k] = (sides[0] - sides[1]) / (2.0 * step.sum())
        return slopes

    def by_warp(self) -> Array:
        """Return (m, 2, warps) derivatives in each warp, which displaces the points of both pictures."""
        elapsed = self.path.elapsed
        off_j = self._warped(self.other, elapsed[self.j])
        transferred = self._warped(self.seen, elapsed[self.i])
        by_pixel = self._slopes("off_j", 0.0, _PIXEL_NUDGE * np.eye(2))
        return np.asarray(transferred - np.matmul(by_pixel, off_j))

    def _warped(self, pixel: Array, elapsed: Array) -> Array:
        """Return (m, 2, warps) displacements of points in px for each unit of a warp."""
        bent = self.matches.lens_distortion.predicted_by_others(pixel, self.earlier)
        return np.concatenate([warp(self.matches.camera, pixel, elapsed), bent[:, :, None]], axis=2)


def reprojection_errors(
    records: Sequence[Record], before: Sequence[FilterParameters], after: Sequence[FilterParameters]
) -> tuple[ChannelError, ...]:
    """Return root mean square errors over all matches, before and after; empty where none has pictures."""
    seen = [k for k, record in enumerate(records) if record.matches is not None]
    if not seen:
        return ()

    def square_px(fit: tuple[Record, FilterParameters]) -> tuple[float, int]:
        """Return the mean square error of one coordinate of a match, and the number of coordinates."""
        record, parameters = fit
        assert record.matches is not None
        found = reprojection_score(record, record.matches, parameters, ())
        # Residuals are weighed by their own noise, which differs little from match to match.
        return found.chi_square / max(found.rows, 1) * float(np.mean(record.matches.std_px**2)), found.rows

    fits = [(records[k], side[k]) for side in (before, after) for k in seen]
    squares, count = np.reshape(in_threads(square_px, fits), (2, len(seen), 2)).T
    if not count.any(axis=0).all():
        return ()
    rms = np.sqrt(np.average(squares, axis=0, weights=count)).tolist()
    return (ChannelError("reprojection", "px", NOT_AHEAD_S, *rms),)


def without_mismatched_pairs(record: Record, parameters: FilterParameters) -> tuple[Record, str]:
    """Return the record without pairs of pictures that are matched to a place of the floor where the flight
    cannot have been, and a message about them; empty if there are none.

    On a repetitive floor, matches with the wrong copy are consistent, also between pairs, but the other
    instruments show the motion. Such a residual is a thousand standard deviations: it outweighs a flight.
    """
    matches = record.matches
    if matches is None:
        return record, ""
    along = camera_path(record, matches, parameters)
    known = np.flatnonzero(along.holds(matches.earlier, matches.later))
    if len(known) == 0:
        return record, ""
    scene, n = _Scene.of(matches, parameters, along), len(along.times_s)
    B, S = scene.by_pose(), along.covariance.reshape(n, 6, n, 6)
    ends = (scene.i, B[:, :, :6]), (scene.j, B[:, :, 6:])
    # The variance of the residuals by the path alone.
    variance = sum(np.einsum("mca,mab,mcb->m", A, S[p, :, q], C) for p, A in ends for q, C in ends)
    off_px, std_px = np.linalg.norm(scene.off(), axis=1), np.sqrt(np.maximum(variance, 0.0))
    pair = matches.earlier[known] * len(matches.stamps_s) + matches.later[known]
    pairs, pair_of = np.unique(pair, return_inverse=True)
    far_px, least_px = off_px - MISMATCH_Z * std_px, MISMATCH * matches.camera.size_px[0]
    wrong = np.array([np.median(far_px[pair_of == k]) > least_px for k in range(len(pairs))])
    if not 0 < wrong.sum() <= MOST_MISMATCHED * len(pairs):
        return record, ""
    kept = np.ones(len(matches.earlier), dtype=bool)
    kept[known[wrong[pair_of]]] = False
    description = (
        f"{record.name}: {wrong.sum()} of {len(pairs)} pairs of pictures match another place of the floor "
        "than the vehicle can have been at; they were left out"
    )
    return replace(record, matches=matches.some(kept)), description
