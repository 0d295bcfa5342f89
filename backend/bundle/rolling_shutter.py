"""The read-out time of a rolling shutter, as far as the residuals of photographs taken in flight show one.

Photographs do not tell by what shutter they were taken. The refined map under a global one is therefore
tested: by the change of all pixels for a second of read-out time, with everything else free to follow it. The
evidence of a rolling shutter is the ratio of the marginal likelihoods with and without that number, under its
prior. Residuals of one picture are dependent, so the likelihood counts by its design effect, as in
`backend.bundle.lens_evidence`. Where the evidence is very strong, the read-out time becomes a variable of the
refinement; else it is fixed at 0.

Velocities are those that the vehicle reports, where the map lies on Earth. Others are those between
neighbours on the map itself, which need no scale. At the ends of strips neither is known. Such a picture
shows its motion itself.

Source: Dickey 1971 (evidence without one of the numbers); Kass and Raftery 1995.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from backend.bundle.exposure_motion import PRIOR_STD_S, READOUT, ExposureMotion
from backend.bundle.factors import LOG_SCALE, SLOPE, rotation_of
from backend.bundle.graph import WORLD, BundleProblem, NoiseLevels, Variables
from backend.bundle.lens_evidence import design_effect
from backend.bundle.minimise import BundleCost, BundleOptimum
from backend.bundle.observations import Cameras
from backend.measurements.straight_flight import continued_velocities, straight_velocities
from backend.significance import VERY_STRONG_NATS
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_DOUBT = 100.0
"""Factor on the noise of pictures of unknown motion where they must not tell the read-out time: all points of
such a picture together then tell no more than one of another."""
_AT_ONCE = 8
"""Pictures of unknown velocity whose motion is found together. A strip ends beside the next one, so
that their pictures share points; more of them would take more memory."""
_SETTLED = 0.05
"""Change of corrected pixels over their noise, as a root of the mean of squares, below which the rounds may
end: it adds a quarter of a percent to the variance of the residuals."""


@dataclass(frozen=True)
class ReadoutEstimate:
    """The time from the exposure of the first row to that of the last, as a refinement has it."""

    readout_s: float
    """0 where it is fixed and nobody states it; negative where the last row is exposed first."""
    std_s: float
    """Standard deviation with which the flight and the prior tell it; 0 where it is stated."""
    prior_std_s: float
    """Standard deviation of what was known before the flight, about 0; 0 where it is stated."""
    is_estimated: bool
    """Whether it was a variable. Otherwise it was fixed."""
    known_velocities: int
    """Number of pictures of which the vehicle or the neighbours tell the velocity."""


@dataclass(frozen=True)
class ReadoutTest:
    """Evidence of a rolling shutter."""

    readout_s: float
    std_s: float
    """Residuals of one picture are dependent, which counts."""
    motion: ExposureMotion

    @property
    def log_evidence(self) -> float:
        """Logarithm of the ratio of the marginal likelihoods with and without a read-out time."""
        return float(0.5 * (self.readout_s / self.std_s) ** 2 - np.log(PRIOR_STD_S / self.std_s))

    @property
    def is_rolling(self) -> bool:
        """Whether this evidence is very strong, as it must be with the read-out time as a variable."""
        return self.log_evidence > VERY_STRONG_NATS


def with_stated_readout(problem: BundleProblem, at: Variables) -> BundleProblem:
    """Return the problem with the read-out time that somebody states, which is fixed."""
    exposure = problem.measurements.exposure
    if exposure is None or exposure.readout_s is None:
        return problem
    return _corrected(problem, at, _exposure_motion(problem, at, exposure.readout_s, is_free=False))


def corrected_rows(
    problem: BundleProblem, at: Variables, noise: NoiseLevels, used: NDArray[np.bool_]
) -> tuple[BundleProblem, Variables, bool]:
    """Return problem and variables with pixels that are corrected by the read-out time and the motion found,
    and whether they are nearly those of before.

    The map was made with the noise and the observations that are ``used`` (m,).
    """
    before = problem.exposure_motion
    if before is None:
        return problem, at, True
    motion = _exposure_motion(problem, at, _readout_s(before, at.values), before.is_free)
    if not motion.is_known.all():
        motion = _with_own_motion(BundleCost.of(problem, noise, used, at.values), at, motion)
    if before.is_free:
        values = gtsam.Values(at.values)
        values.update(READOUT, np.zeros(1))
        at = replace(at, values=values)
    found = _corrected(problem, at, motion)
    changed = (found.tracks.pixel - problem.tracks.pixel) / problem.tracks.std_px[:, None]
    return found, at, not len(changed) or bool(np.sqrt(np.mean(changed**2)) < _SETTLED)


def readout_test(optimum: BundleOptimum) -> ReadoutTest | None:
    """Return the evidence of a rolling shutter at the noise of a map; None where its read-out time is stated,
    no picture is known to move, or the flight leaves a direction open.

    The map was made for a global shutter, or with the read-out time as a variable.
    """
    problem = optimum.problem
    motion, at = problem.exposure_motion, optimum.at
    if problem.measurements.exposure is None or (motion is not None and not motion.is_free):
        return None
    if motion is None:
        motion = _exposure_motion(problem, at, 0.0, is_free=True)
        if not motion.is_known.any():
            return None
        problem, at = _with_free_readout(problem, at, motion)
    cost = _doubting_cost(problem, optimum, at)
    doubted = replace(optimum, cost=cost, at=at, structure=cost.structure(at))
    linear = doubted.linearise()
    try:
        reduced = linear.eliminate()
    except SingularMatrixError:
        return None
    (jacobian, residuals), columns = linear.jacobian(), reduced.structure.columns(READOUT)
    step, _ = reduced.solve(*linear.gradient)
    unit = np.zeros((reduced.size, 1))
    unit[columns] = 1.0
    change = reduced.solve(unit, np.zeros((jacobian.shape[1] - reduced.size, 1)))
    effect = design_effect(doubted, np.asarray(jacobian @ np.vstack(change))[:, 0], residuals)
    found = _readout_s(motion, at.values) + float(step[columns][0])
    # The prior is no residual of the pictures.
    precision = (1.0 / float(change[0][columns][0, 0]) - PRIOR_STD_S**-2.0) / effect
    readout_s = found * (precision + PRIOR_STD_S**-2.0 / effect) / (precision + PRIOR_STD_S**-2.0)
    return ReadoutTest(readout_s, (precision + PRIOR_STD_S**-2.0) ** -0.5, motion)


def _doubting_cost(problem: BundleProblem, optimum: BundleOptimum, at: Variables) -> BundleCost:
    """Return the cost in which pictures of unknown motion hardly count.

    They are bent alike, or not: taken as they are, they would tell that the others are not bent.
    """
    cost = BundleCost.of(problem, optimum.noise, optimum.used, at.values)
    seen, motion = cost.observations, problem.exposure_motion
    assert motion is not None
    doubt = np.where(motion.is_known[seen.keyframe], 1.0, _DOUBT)
    return replace(cost, observations=replace(seen, std_px=doubt * seen.std_px))


def freed_readout(optimum: BundleOptimum, test: ReadoutTest | None) -> tuple[BundleProblem, Variables] | None:
    """Return problem and variables with the read-out time as a variable; None without any evidence for it.

    A map with the wrong shutter has so much noise that its evidence is weak: `ReadoutTest.is_rolling` of
    the solved one decides.
    """
    if test is None or test.log_evidence <= 0:
        return None
    return _with_free_readout(optimum.problem, optimum.at, replace(test.motion, readout_s=test.readout_s))


def _with_free_readout(
    problem: BundleProblem, at: Variables, motion: ExposureMotion
) -> tuple[BundleProblem, Variables]:
    values = gtsam.Values(at.values)
    values.insert(READOUT, np.zeros(1))
    at = replace(at, values=values)
    return _corrected(problem, at, motion), at


def readout_estimate(optimum: BundleOptimum, test: ReadoutTest | None) -> ReadoutEstimate | None:
    """Return the read-out time of a map; None where nothing is known of how its rows were exposed.

    ``test`` is that of the map, or of another one that is not believed.
    """
    motion = optimum.problem.exposure_motion
    if motion is None:
        if test is None:
            return None
        return ReadoutEstimate(0.0, test.std_s, PRIOR_STD_S, False, _known(test.motion))
    if not motion.is_free or test is None:
        return ReadoutEstimate(motion.readout_s, 0.0, 0.0, False, _known(motion))
    readout_s = _readout_s(motion, optimum.values)
    return ReadoutEstimate(readout_s, test.std_s, PRIOR_STD_S, True, _known(motion))


def row_motion_m(optimum: BundleOptimum) -> Array | None:
    """Return the motion (n, 3) of the cameras in body axes from the exposure of the first row to that of the
    last; None for a global shutter."""
    problem, motion = optimum.problem, optimum.problem.exposure_motion
    if motion is None:
        return None
    f_T_c = Cameras.of(problem, optimum.values).f_T_c
    scale = float(np.exp(optimum.values.atVector(WORLD)[LOG_SCALE]))
    moved = scale * motion.over_rows(_readout_s(motion, optimum.values))
    b_R_f = problem.b_T_c(optimum.values)[:3, :3] @ np.swapaxes(f_T_c[:, :3, :3], 1, 2)
    return np.asarray(np.einsum("nab,nb->na", b_R_f, moved))


def _readout_s(motion: ExposureMotion, values: gtsam.Values) -> float:
    """Return the read-out time of a motion, with its correction by the variables."""
    return motion.readout_s + (float(values.atVector(READOUT)[0]) if motion.is_free else 0.0)


def _known(motion: ExposureMotion) -> int:
    return int(motion.is_known.sum())


def _exposure_motion(
    problem: BundleProblem, at: Variables, readout_s: float, is_free: bool
) -> ExposureMotion:
    """Return the motion by the poses found; pictures of unknown motion first count as flown on evenly."""
    measured, tracks = problem.measurements, problem.tracks
    assert measured.exposure is not None
    place = np.array([at.values.atPose3(POSE(k)).translation() for k in range(measured.count)])
    velocity = straight_velocities(measured.stamps_s, place)
    if measured.placed:
        world = at.values.atVector(WORLD)
        reported = measured.exposure.w_v_m_s @ rotation_of(world, SLOPE) / np.exp(world[LOG_SCALE])
        velocity = np.where(np.isfinite(reported), reported, velocity)
    is_known = np.asarray(np.isfinite(velocity).all(axis=1))
    before = problem.exposure_motion
    recorded_px = np.asarray(tracks.pixel, dtype=float) if before is None else before.recorded_px
    f_v = continued_velocities(measured.stamps_s, place, velocity)
    own = np.where(is_known[:, None], 0.0, readout_s * f_v)
    return ExposureMotion(f_v, is_known, own, measured.exposure.rows, readout_s, is_free, recorded_px)


def _with_own_motion(cost: BundleCost, at: Variables, motion: ExposureMotion) -> ExposureMotion:
    """Return the motion, with what pictures of unknown velocity show of their own.

    One step of Gauss and Newton finds it, and all variables follow. Its prior is an even flight, within the
    speed of the other pictures: at the ends of strips, some vehicles stop and others take no notice.
    """
    assert cost.problem.exposure_motion is not None
    if not motion.is_known.any():
        return motion
    speed = np.sqrt(np.mean(np.sum(motion.f_v[motion.is_known] ** 2, axis=1)))
    std = speed * (PRIOR_STD_S if motion.is_free else abs(motion.readout_s))
    if std == 0.0:
        return motion
    linear = cost.linearise(at, cost.structure(at))
    reduced, (jacobian, right) = linear.eliminate(), linear.jacobian()
    step, seen, own = reduced.solve(*linear.gradient), cost.observations, motion.own_motion.copy()
    right = right - jacobian @ np.concatenate(step)
    late = -motion.since_middle(motion.recorded_px[seen.number])[:, None, None] * linear.seen.of_point
    before, precision = cost.problem.exposure_motion.own_motion, std**-2.0
    unknown = np.flatnonzero(~motion.is_known)
    for some in np.array_split(unknown, -(-len(unknown) // _AT_ONCE)):
        mine = np.flatnonzero(np.isin(seen.keyframe, some))
        columns = 3 * np.searchsorted(some, seen.keyframe[mine])[:, None] + np.arange(3)
        rows = (2 * mine[:, None] + np.arange(2)).ravel()
        entries = late[mine].ravel(), (np.repeat(rows, 3), np.repeat(columns, 2, axis=0).ravel())
        by_own = csr_array(coo_array(entries, shape=(len(right), 3 * len(some))))
        mixed = (jacobian.T @ by_own).toarray()
        follow = np.vstack(reduced.solve(mixed[: reduced.size], mixed[reduced.size :]))
        left = (by_own.T @ by_own).toarray() - mixed.T @ follow + precision * np.eye(len(follow.T))
        even = (motion.own_motion - before)[some].ravel()
        change = np.linalg.solve(left, by_own.T @ right + precision * even)
        own[some] = before[some] + change.reshape(-1, 3)
    return replace(motion, own_motion=own)


def _corrected(problem: BundleProblem, at: Variables, motion: ExposureMotion) -> BundleProblem:
    """Return the problem with the motion, and the pixels as its read-out time corrects them."""
    cameras, tracks = Cameras.of(problem, at.values), problem.tracks
    pixel = motion.as_at_once(tracks.keyframe, tracks.track, cameras.f_T_c, at.point, cameras.calibration)
    return replace(problem, exposure_motion=motion, tracks=replace(tracks, pixel=pixel))
