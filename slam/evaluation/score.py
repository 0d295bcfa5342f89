"""All figures of one evaluation, computed once for the table, the pictures and evaluation.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.arguments import check_estimate, check_flight
from slam.core.estimate import MAP_TRAJECTORIES, Estimate
from slam.core.flight import Flight
from slam.core.summary import without_nan
from slam.evaluation.aligned_maps import AlignedMaps, aligned_maps
from slam.evaluation.association import Association, associate, incomplete_rows, seeing_camera
from slam.evaluation.coarse_truth import FewRows, judged_by_truth, too_coarse, too_few_rows
from slam.evaluation.landmarks import (
    LandmarkDistance,
    LandmarkPlace,
    LoopGap,
    landmark_table,
    landmarks_on_chain,
    landmarks_on_map,
)
from slam.evaluation.loop_score import LoopScore, score_loops
from slam.evaluation.nees import Nees, nees
from slam.evaluation.trajectory import ErrorSummary, RelativeError, position_error, relative_errors, umeyama
from slam.evaluation.truth_clock import TruthClock, truth_clock

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tracks:
    """Data of the pictures: the associated keyframes, with the first one's position and yaw on the truth's.

    With GPS as the reference nothing is aligned.
    """

    stamps_s: Array
    """(m,) seconds since the flight's first keyframe."""
    reference_m: Array
    """(m, 3) positions of the reference, in metres."""
    chain_m: Array
    """(m, 3) positions of the chain, in metres; NaN where not placed."""
    odometry_m: Array
    """(m, 3) positions without loops, in metres."""
    loops_m: Array
    """(m, 3) positions of the estimate, in metres."""
    std_m: Array
    """(m, 3) standard deviations of the position in world axes; NaN where unknown."""
    nees: Array
    """(m,) NEES of each pose; NaN where there is none."""
    landmarks_m: dict[str, Array]


@dataclass(frozen=True)
class Evaluation:
    """Errors of an estimate against its reference."""

    name: str
    reference: str
    """The reference: "truth", or "gps" where there is no truth."""
    dimensions: int
    """Number of compared axes; 2 where the reference has no height."""
    keyframes: int
    associated: int
    left_out: dict[str, int]
    """Number of keyframes that were not compared, by reason."""
    ate_m: ErrorSummary
    """Position errors with the first keyframe's position and yaw on the truth's; with GPS nothing is
    aligned."""
    ate_aligned_m: ErrorSummary
    """Position errors after the least-squares rigid motion."""
    ate_sim3_m: ErrorSummary
    """Position errors after the least-squares similarity."""
    scale: float
    """Scale of that similarity: above 1 where the estimate is too small."""
    rpe: tuple[RelativeError, ...]
    """Relative errors; empty where the reference is GPS."""
    nees: Nees | None
    too_coarse: int
    """Number of keyframes left out of the NEES, because the truth's neighbouring rows are too far apart for
    the motion. If the first one is among them there is no NEES."""
    landmarks: tuple[LandmarkDistance, ...]
    loop_gaps: tuple[LoopGap, ...]
    landmarks_on_map: tuple[LandmarkPlace, ...]
    """The landmarks on the map, which is not aligned with the truth."""
    landmarks_on_chain: tuple[LandmarkPlace, ...]
    """The landmarks on the map of the plain chain, once for each visit."""
    loops: LoopScore | None
    """Score of the loops; None without truth or camera."""
    tracks: Tracks
    truth_clock: TruthClock | None = None
    """How late the truth's stamps are, where a shift of them at least halves the errors."""
    too_few_rows: FewRows | None = None
    """Keyframes whose errors may be those of the truth instead; None where the truth has rows enough."""
    incomplete_rows: int = 0
    """Number of rows of the truth that hold no whole pose, as one with the quaternion 0 0 0 0."""
    metric: bool = True
    """Whether the estimate's lengths are metres, as those of the reference are."""
    trajectory_names: tuple[str, str, str] = MAP_TRAJECTORIES
    """Names of the chain, the odometry and the estimate in tables and legends."""

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``evaluation.json``; a figure that is not finite becomes null."""
        record = {
            "name": self.name,
            "reference": self.reference,
            "dimensions": self.dimensions,
            "keyframes": self.keyframes,
            "associated": self.associated,
            "left_out": self.left_out,
            "ate_m": _errors(self.ate_m),
            "ate_aligned_m": _errors(self.ate_aligned_m),
            "ate_sim3_m": {**_errors(self.ate_sim3_m), "scale": self.scale},
            "too_few_truth_rows": _few_rows(self.too_few_rows),
            "incomplete_truth_rows": self.incomplete_rows,
            "truth_clock": None if self.truth_clock is None else dict(vars(self.truth_clock)),
            "rpe": {error.step: _relative(error) for error in self.rpe},
            "nees": {**_nees(self.nees), "too_coarse": self.too_coarse},
            "landmarks": {row.name: _landmark(row) for row in self.landmarks},
            "loop_gap_m": {gap.name: _gap(gap) for gap in self.loop_gaps},
            "loops": None if self.loops is None else dict(vars(self.loops)),
        }
        return dict(without_nan(record))


def evaluate(estimate: Estimate, flight: Flight) -> Evaluation:
    """Compare an estimate with the truth of its flight, or with its GPS where there is no truth.

    Raises ``InputError`` where the flight has neither, or has nothing in common with the estimate.
    """
    check_estimate(estimate)
    check_flight(flight)
    association = judged_by_truth(estimate, associate(estimate, flight))
    maps = aligned_maps(estimate, association)
    used = slice(0, association.dimensions)
    estimated_m, reference_m = maps.loops.w_T_b[:, :3, 3].copy(), association.position_m.copy()
    estimated_m[:, 2] *= association.dimensions == 3
    reference_m[:, 2] *= association.dimensions == 3
    start = 0 if association.w_T_b is None else 4  # unknowns: the first position, and the yaw
    motion = 6 if association.dimensions == 3 else 3
    rigid = umeyama(estimated_m, reference_m, with_scale=False)
    similar = umeyama(estimated_m, reference_m, with_scale=True)
    coarse = too_coarse(estimate, association)
    unit_m = 1.0 if estimate.metric else similar.scale
    consistency, per_keyframe = _consistency(estimate, association, maps.loops.w_T_b, coarse, unit_m)
    landmarks, gaps = landmark_table(estimate, flight, association, maps, unit_m)
    return Evaluation(
        name=estimate.name,
        reference=association.reference,
        dimensions=association.dimensions,
        keyframes=len(estimate.stamps_s),
        associated=len(association.keyframe),
        left_out=association.left_out,
        ate_m=position_error(estimated_m[:, used], reference_m[:, used], start),
        ate_aligned_m=position_error(rigid.apply(estimated_m)[:, used], reference_m[:, used], motion),
        ate_sim3_m=position_error(similar.apply(estimated_m)[:, used], reference_m[:, used], motion + 1),
        scale=similar.scale if reference_m[:, used].size > motion + 1 else float("nan"),
        truth_clock=truth_clock(estimate, flight, association),
        rpe=_relative_errors(estimate, association),
        nees=consistency,
        too_coarse=int(coarse.sum()),
        landmarks=landmarks,
        loop_gaps=gaps,
        landmarks_on_map=landmarks_on_map(estimate, flight, association),
        landmarks_on_chain=landmarks_on_chain(estimate, flight, association),
        loops=_loops(estimate, flight, association),
        tracks=_tracks(estimate, flight, association, maps, per_keyframe),
        too_few_rows=too_few_rows(estimate, association),
        incomplete_rows=0 if flight.truth is None else incomplete_rows(flight.truth),
        metric=estimate.metric,
        trajectory_names=estimate.trajectory_names,
    )


def _relative_errors(estimate: Estimate, association: Association) -> tuple[RelativeError, ...]:
    if association.w_T_b is None:
        return ()
    k = association.keyframe
    return relative_errors(estimate.stamps_s[k], k, estimate.w_T_b[k], association.w_T_b)


def _consistency(
    estimate: Estimate,
    association: Association,
    aligned_w_T_b: Array,
    coarse: NDArray[np.bool_],
    unit_m: float,
) -> tuple[Nees | None, Array]:
    """NEES of all but the first keyframe, which fixes the gauge: its errors are zero by construction.

    ``unit_m`` is the length of the map's unit.
    """
    per_keyframe = np.full(len(association.keyframe), np.nan)
    if association.w_T_b is None or len(per_keyframe) < 2 or coarse[0]:
        return None, per_keyframe
    to_metres = np.repeat([1.0, unit_m], 3)
    covariances = to_metres[:, None] * estimate.covariances[association.keyframe] * to_metres
    covariances[coarse] = np.nan
    w_T_b = aligned_w_T_b.copy()
    w_T_b[:, :3, 3] += (unit_m - 1.0) * (w_T_b[:, :3, 3] - w_T_b[0, :3, 3])
    joint = to_metres[:, None] * _joint_errors(estimate, association.keyframe)
    result = nees(w_T_b[1:], association.w_T_b[1:], covariances[1:], joint[1:])
    if result is not None:
        per_keyframe[1:] = result.per_keyframe
    return result, per_keyframe


def _joint_errors(estimate: Estimate, keyframe: NDArray[np.int64]) -> Array:
    """(m, 6, s) errors that keyframes (m,) share; where they are not known, that of the scale alone, if there
    is one. With GPS, scale and position are known together."""
    if estimate.joint_errors is not None:
        return estimate.joint_errors[keyframe]
    if estimate.scale_std is None or estimate.origin is not None:
        return np.zeros((len(keyframe), 6, 0))
    w_T_b = estimate.w_T_b[keyframe]
    away = w_T_b[:, :3, 3] - w_T_b[0, :3, 3]
    in_body = np.einsum("nij,ni->nj", w_T_b[:, :3, :3], away)
    return np.asarray(np.pad(estimate.scale_std * in_body, ((0, 0), (3, 0)))[:, :, None])


def _loops(estimate: Estimate, flight: Flight, association: Association) -> LoopScore | None:
    camera = seeing_camera(estimate, flight)
    if (
        association.w_T_b is None or camera is None or estimate.trajectory_names != MAP_TRAJECTORIES
    ):  # loops are a map's
        return None
    return score_loops(estimate.loops, estimate.stamps_s, association.keyframe, association.w_T_b, camera)


def _tracks(
    estimate: Estimate, flight: Flight, association: Association, maps: AlignedMaps, per_keyframe: Array
) -> Tracks:
    k = association.keyframe
    w_R_b = maps.loops.w_T_b[:, :3, :3]
    P_w = w_R_b @ estimate.covariances[k][:, 3:, 3:] @ w_R_b.transpose(0, 2, 1)
    variance = np.diagonal(P_w, axis1=1, axis2=2)
    return Tracks(
        stamps_s=estimate.stamps_s[k] - estimate.stamps_s[0],
        reference_m=association.position_m,
        chain_m=maps.chain.w_T_b[:, :3, 3],
        odometry_m=maps.odometry.w_T_b[:, :3, 3],
        loops_m=maps.loops.w_T_b[:, :3, 3],
        std_m=np.sqrt(np.where(variance >= 0, variance, np.nan)),
        nees=per_keyframe,
        landmarks_m=dict(flight.landmarks) if association.w_T_b is not None else {},
    )


def _errors(errors: ErrorSummary) -> dict[str, float]:
    return {"rmse": errors.rmse, "max": errors.max}


def _few_rows(few: FewRows | None) -> dict[str, Any] | None:
    return None if few is None else {**vars(few), "ate_at_rows_m": _errors(few.ate_at_rows_m)}


def _relative(error: RelativeError) -> dict[str, Any]:
    return {
        "pairs": error.pairs,
        "translation_m": _errors(error.translation_m),
        "translation_percent": error.translation_percent,
        "rotation_deg": _errors(error.rotation_deg),
    }


def _nees(result: Nees | None) -> dict[str, Any]:
    if result is None:
        return {"mean": None, "lower95": None, "upper95": None, "dof": 6}
    return {
        **vars(result.pose),
        "position": dict(vars(result.position)),
        "rotation": dict(vars(result.rotation)),
        "left_out": result.left_out,
    }


def _landmark(row: LandmarkDistance) -> dict[str, float]:
    return {
        "truth_m": row.truth_m,
        "measured_m": row.measured_m.loops,
        "error_m": row.error_m.loops,
        "error_percent": row.error_percent.loops,
        "odometry_error_percent": row.error_percent.odometry,
        "chain_error_percent": row.error_percent.chain,
    }


def _gap(gap: LoopGap) -> dict[str, float]:
    return {
        "truth_m": gap.truth_m,
        "chain_error_m": gap.error_m.chain,
        "odometry_error_m": gap.error_m.odometry,
        "error_m": gap.error_m.loops,
    }
