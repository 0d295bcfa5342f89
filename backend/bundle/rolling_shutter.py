"""The read-out time of a rolling shutter, as far as the residuals of pictures taken in motion show one.

Pictures do not tell by what shutter they were taken. The map refined for a global one, or for the time that
somebody states, is therefore tested: by the change of all pixels for a second of read-out time, with
everything else free to follow it. The evidence of another time is the ratio of two marginal likelihoods: with
that number free under its prior, over that with it fixed. Residuals of one picture are dependent, so the
likelihood counts by its design effect, as in `backend.bundle.lens_evidence`. Where the evidence is very
strong, the read-out time becomes a variable of the refinement; else it is fixed.

The frames of a video show how the camera moves and turns. Velocities of photographs are those that the
vehicle reports, where the map lies on Earth. Others are those between neighbours on the map itself, which
need no scale. At the ends of strips neither is known. Such a picture shows its motion itself.

Source: Dickey 1971 (evidence without one of the numbers); Kass and Raftery 1995.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.exposure_motion import PRIOR_STD_S, READOUT, ExposureMotion, since_middle
from backend.bundle.factors import LOG_SCALE, SLOPE, WORLD, rotation_of
from backend.bundle.floor_speed import camera_motion
from backend.bundle.lens_evidence import design_effect
from backend.bundle.minimise import BundleCost, BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.picture_variables import picture_variables
from backend.bundle.problem import BundleProblem, NoiseLevels, Variables
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
    """Standard deviation with which the flight and the prior tell it; 0 where it is fixed as stated."""
    prior_std_s: float
    """Standard deviation of what was known before the flight, about 0; 0 where it is fixed as stated."""
    stated_s: float | None
    """Time that somebody states; None for nobody."""
    is_estimated: bool
    """Whether it was a variable. Otherwise it was fixed."""
    known_velocities: int
    """Number of pictures of which the vehicle, the neighbours, or the frames of a video tell the velocity."""


@dataclass(frozen=True)
class ReadoutTest:
    """Evidence of another read-out time than the fixed one."""

    fixed_s: float
    """Time that is stated, or 0."""
    readout_s: float
    std_s: float
    """Residuals of one picture are dependent, which counts."""
    motion: ExposureMotion

    @property
    def log_evidence(self) -> float:
        """Logarithm of the marginal likelihood with a free read-out time over that with the fixed one.

        It is that of the density of the prior over that of the posterior, both at the fixed time.
        """
        prior, posterior = self.fixed_s / PRIOR_STD_S, (self.readout_s - self.fixed_s) / self.std_s
        return float(0.5 * (posterior**2 - prior**2) - np.log(PRIOR_STD_S / self.std_s))

    @property
    def refutes_fixed(self) -> bool:
        """Whether this evidence is very strong, as it must be with the read-out time as a variable."""
        return self.log_evidence > VERY_STRONG_NATS


def with_known_readout(problem: BundleProblem, at: Variables) -> tuple[BundleProblem, Variables]:
    """Return problem and variables with the read-out time that somebody states, which is fixed, or with that
    of an earlier map, which is a variable."""
    exposure = problem.measurements.exposure
    if exposure is None:
        return problem, at
    if exposure.is_refuted:
        motion = _exposure_motion(problem, at, exposure.corrected_s, is_free=True)
        if motion.is_known.any():
            return _with_free_readout(problem, at, motion)
    if exposure.readout_s is None and exposure.corrected_s == 0:
        return problem, at
    at_s = exposure.corrected_s if exposure.is_refuted else exposure.fixed_s
    return _corrected(problem, at, _exposure_motion(problem, at, at_s, is_free=False)), at


def corrected_rows(
    problem: BundleProblem, at: Variables, noise: NoiseLevels, used: NDArray[np.bool_]
) -> tuple[BundleProblem, Variables, bool]:
    """Return problem and variables with pixels that are corrected by the read-out time and the motion found,
    and whether they are nearly the same as before.

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
    """Return the evidence of another read-out time than the fixed one at the noise of a map; None where no
    picture is known to move, or the flight leaves a direction open.

    The map was made with the fixed time, or with it as a variable.
    """
    problem = optimum.problem
    motion, at, exposure = problem.exposure_motion, optimum.at, problem.measurements.exposure
    if exposure is None:
        return None
    if motion is None or not motion.is_free:
        motion = _exposure_motion(problem, at, motion.readout_s if motion else 0.0, is_free=True)
        if not motion.is_known.any():
            return None
        problem, at = _with_free_readout(problem, at, motion)
    cost = _doubting_cost(problem, optimum, at)
    doubted = replace(optimum, cost=cost, at=at, structure=cost.structure(at))
    try:
        linear, reduced = doubted.eliminated()
    except SingularMatrixError:
        return None
    step, _ = reduced.solve(*linear.gradient)
    columns = reduced.structure.columns(READOUT)
    unit = np.zeros((reduced.size, 1))
    unit[columns] = 1.0
    change = reduced.solve(unit, np.zeros((at.point.size, 1)))
    effect = design_effect(doubted, linear.times(*change)[:, 0], linear.right)
    found = _readout_s(motion, at.values) + float(step[columns][0])
    # The prior is no residual of the pictures.
    precision = (1.0 / float(change[0][columns][0, 0]) - PRIOR_STD_S**-2.0) / effect
    readout_s = found * (precision + PRIOR_STD_S**-2.0 / effect) / (precision + PRIOR_STD_S**-2.0)
    return ReadoutTest(exposure.fixed_s, readout_s, (precision + PRIOR_STD_S**-2.0) ** -0.5, motion)


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
    """Return problem and variables with the read-out time as a variable; None without any evidence for it, or
    where it is one already.

    A map with the wrong shutter has so much noise that its evidence is weak: `ReadoutTest.refutes_fixed` of
    the solved one decides.
    """
    if test is None or test.log_evidence <= 0 or optimum.problem.estimates_readout:
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
    motion, exposure = optimum.problem.exposure_motion, optimum.problem.measurements.exposure
    stated_s = None if exposure is None else exposure.readout_s
    if motion is None:
        if test is None:
            return None
        return ReadoutEstimate(0.0, test.std_s, PRIOR_STD_S, stated_s, False, _known(test.motion))
    if not motion.is_free or test is None:
        return ReadoutEstimate(motion.readout_s, 0.0, 0.0, stated_s, False, _known(motion))
    readout_s = _readout_s(motion, optimum.values)
    return ReadoutEstimate(readout_s, test.std_s, PRIOR_STD_S, stated_s, True, _known(motion))


def row_motion(optimum: BundleOptimum) -> tuple[Array | None, Array | None]:
    """Return how far the cameras move (n, 3), in metres, and how they turn (n, 3), in rad, in body axes, from
    the exposure of the first row to that of the last; None for a global shutter."""
    problem, motion = optimum.problem, optimum.problem.exposure_motion
    if motion is None:
        return None, None
    f_T_c = Cameras.of(problem, optimum.values).f_T_c
    scale = optimum.transform.scale
    readout_s = _readout_s(motion, optimum.values)
    b_R_f = problem.b_T_c(optimum.values)[:3, :3] @ np.swapaxes(f_T_c[:, :3, :3], 1, 2)
    moved = np.einsum("nab,nb->na", b_R_f, scale * motion.over_rows(readout_s))
    return moved, np.einsum("nab,nb->na", b_R_f, readout_s * motion.f_turn)


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
    f_T_c = Cameras.of(problem, at.values).f_T_c
    place = f_T_c[:, :3, 3]
    velocity, f_turn, corrected_s = _known_motion(problem, at, f_T_c)
    is_known = np.asarray(np.isfinite(velocity).all(axis=1))
    before = problem.exposure_motion
    recorded_px = np.asarray(tracks.pixel, dtype=float) if before is None else before.recorded_px
    f_v = continued_velocities(measured.stamps_s, place, velocity)
    own = np.where(is_known[:, None], 0.0, readout_s * f_v)
    rows = measured.exposure.rows
    late = since_middle(recorded_px, rows)[:, None]
    turned = np.cross(f_turn[tracks.keyframe], at.point[tracks.track] - place[tracks.keyframe])
    by_second = late * (np.where(is_known[:, None], f_v, 0.0)[tracks.keyframe] + turned)
    return ExposureMotion(
        f_v, f_turn, is_known, own, rows, readout_s, is_free, recorded_px, corrected_s, by_second
    )


def _known_motion(problem: BundleProblem, at: Variables, f_T_c: Array) -> tuple[Array, Array, Array]:
    """Return velocities (n, 3) of the cameras, NaN where they are not known, angular velocities (n, 3), and
    the read-out times (n,) that the pixels are corrected by already."""
    measured = problem.measurements
    exposure, n = measured.exposure, len(f_T_c)
    assert exposure is not None
    if exposure.floor_speed is not None and exposure.xy is not None:
        f_v, f_turn = camera_motion(f_T_c, exposure.xy, exposure.floor_speed)
        is_known = np.isfinite(f_v).all(axis=1)
        return f_v, np.nan_to_num(f_turn), np.where(is_known, exposure.corrected_s, 0.0)
    velocity = straight_velocities(measured.stamps_s, f_T_c[:, :3, 3])
    if measured.placed:
        world = at.values.atVector(WORLD)
        reported = exposure.w_v_m_s @ rotation_of(world, SLOPE) / np.exp(world[LOG_SCALE])
        velocity = np.where(np.isfinite(reported), reported, velocity)
    return velocity, np.zeros((n, 3)), np.zeros(n)


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
    try:
        reduced = linear.eliminate()
    except SingularMatrixError:  # where the flight leaves a direction open, nothing follows of a motion
        return motion
    seen, own, precision = cost.observations, motion.own_motion.copy(), std**-2.0
    late = -since_middle(motion.recorded_px[seen.number], motion.rows)[:, None, None] * linear.seen.of_point
    before, unknown = cost.problem.exposure_motion.own_motion, np.flatnonzero(~motion.is_known)
    for found in picture_variables(linear, reduced, unknown, late, _AT_ONCE):
        even = (motion.own_motion - before)[found.pictures].ravel()
        information = found.information + precision * np.eye(len(even))
        change = np.linalg.solve(information, found.gradient + precision * even)
        own[found.pictures] = before[found.pictures] + change.reshape(-1, 3)
    return replace(motion, own_motion=own)


def _corrected(problem: BundleProblem, at: Variables, motion: ExposureMotion) -> BundleProblem:
    """Return the problem with the motion, and the pixels as its read-out time corrects them."""
    cameras, tracks = Cameras.of(problem, at.values), problem.tracks
    pixel = motion.as_at_once(tracks.keyframe, tracks.track, cameras.f_T_c, at.point, cameras.calibration)
    return replace(problem, exposure_motion=motion, tracks=replace(tracks, pixel=pixel))
