"""Association of keyframes with the reference: which can be compared, and the reference pose at their
times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from frontend.camera import Camera
from slam.core.errors import InputError, one_line
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.streams import Truth
from slam.evaluation.chord import off_the_chord

Array = NDArray[np.float64]

_GAP_S = 0.2
"""The truth is interpolated across an interval of at most this length, or three of its median intervals."""
_STAMP_TOLERANCE_S = 1e-6
"""Stamps nearer than this count as equal: float64 seconds since two epochs differ in the last digit."""


@dataclass(frozen=True)
class Association:
    """The reference at the times of the keyframes that it covers."""

    reference: Literal["truth", "gps"]
    keyframe: NDArray[np.int64]
    """(m,) numbers of the keyframes, increasing."""
    position_m: Array
    """(m, 3) reference positions of the body origin, in metres."""
    w_T_b: Array | None
    """(m, 4, 4) reference poses; None where the reference is GPS."""
    left_out: dict[str, int]
    """Number of keyframes that are not compared, by reason."""
    dimensions: int = 3
    """Number of compared axes. It is 2 where the reference has no height: no error then includes z."""
    between_rows: Array | None = None
    """(m, 2) interpolation errors of the truth by its own curvature, in rad and m; None for GPS."""
    map_off_line: Array | None = None
    """(m, 2) how far the map leaves the straight line between rows, in rad and m; None for GPS. Either may
    be wrong there: the map, or the line."""
    to_row_s: Array | None = None
    """(m,) time to the nearest row of the truth, in seconds; None for GPS."""

    def of(self, which: NDArray[np.bool_], reason: str) -> Association:
        """Return the association of some keyframes (m,); the others are left out for a reason."""
        left_out = self.left_out | {reason: self.left_out.get(reason, 0) + int((~which).sum())}
        about = (self.w_T_b, self.between_rows, self.map_off_line, self.to_row_s)
        w_T_b, between, off_line, to_row_s = (None if a is None else a[which] for a in about)
        return replace(
            self,
            keyframe=self.keyframe[which],
            position_m=self.position_m[which],
            w_T_b=w_T_b,
            left_out=left_out,
            between_rows=between,
            map_off_line=off_line,
            to_row_s=to_row_s,
        )


def associate(estimate: Estimate, flight: Flight) -> Association:
    """Find the reference of each placed keyframe: the truth, or GPS where there is none.

    The truth's position is interpolated linearly and its rotation along the shortest arc. Both are
    interpolated only inside the truth's time range and across short intervals. A GPS fix counts within half a
    median interval of a keyframe. Without a common origin on Earth, unconnected parts of a graph have no
    relation to each other; then only the largest part is compared. Raises ``InputError`` where nothing can be
    compared.
    """
    _refuse_other_pictures(estimate, flight)
    stamps_s = stamps_on_clock(estimate, flight)
    comparable, left_out = _comparable(estimate)
    if flight.truth is not None and len(flight.truth.stamps_s) > 0:
        found = _with_truth(estimate, stamps_s, comparable, left_out, flight.truth)
        span_s = flight.truth.stamps_s[[0, -1]]
    elif flight.gps is not None and len(flight.gps.stamps_s) > 0:
        found = _with_gps(estimate, flight, stamps_s, comparable, left_out)
        span_s = flight.gps.stamps_s[[0, -1]]
    else:
        raise InputError(_no_reference(flight))
    if len(found.keyframe) == 0:
        raise InputError(_nothing_in_common(estimate, flight, found, stamps_s, span_s))
    return found


def stamps_on_clock(estimate: Estimate, flight: Flight) -> Array:
    """Return the stamps (n,) of the keyframes on the clock of the flight, in seconds."""
    return estimate.stamps_s + (estimate.epoch_ns - flight.epoch_ns) * 1e-9


def seeing_camera(estimate: Estimate, flight: Flight) -> Camera | None:
    """Return the camera that took the pictures: the flight's camera, with the mount that the map has
    estimated.

    The estimate's own camera is returned where the flight has none; None where neither has one.
    """
    nominal, estimated = flight.camera, estimate.camera
    if nominal is None or estimated is None:
        return nominal or estimated
    return replace(nominal, b_T_c=estimated.b_T_c) if estimated.has_free_mount else nominal


def _refuse_other_pictures(estimate: Estimate, flight: Flight) -> None:
    """Raise where no picture is common: two simulated flights share a clock and could be compared by
    mistake."""
    if estimate.camera is None or flight.frames is None or not estimate.frame_names:
        return
    if not set(estimate.frame_names) & set(flight.frames.names):
        raise InputError(
            one_line(
                f"{flight.name}: has none of the pictures of {estimate.name}, such as "
                f"{estimate.frame_names[0]}; give the flight that the map was made of"
            )
        )


def _no_reference(flight: Flight) -> str:
    streams = ("state_groundtruth_estimate0", "gps0")
    dropped = [message.text for message in flight.messages if message.about in streams]
    return one_line(
        f"{flight.name}: has neither truth nor GPS to compare with; "
        + ("; ".join(dropped) or f"add {' or '.join(streams)} to the flight")
    )


def _nothing_in_common(
    estimate: Estimate, flight: Flight, found: Association, stamps_s: Array, span_s: Array
) -> str:
    reasons = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items()) or "no keyframes"
    times = ""
    if len(stamps_s):
        times = (
            f"; keyframes from {stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s, "
            f"{found.reference} from {span_s[0]:.3f} to {span_s[1]:.3f} s"
        )
    return one_line(
        f"{flight.name}: no keyframe of {estimate.name} can be compared with its {found.reference} "
        f"({reasons}{times}); check that it is the same flight on the same clock"
    )


def _comparable(estimate: Estimate) -> tuple[NDArray[np.bool_], dict[str, int]]:
    placed = np.asarray(np.isfinite(estimate.w_T_b).all(axis=(1, 2)))
    one_world: NDArray[np.bool_] = (
        estimate.component >= 0 if estimate.origin is not None else estimate.component == 0
    )
    left_out: dict[str, int] = {}
    _count(left_out, "not placed", ~placed)
    _count(left_out, "in a part that is not connected to the largest", placed & ~one_world)
    return placed & one_world, left_out


def _count(left_out: dict[str, int], reason: str, mask: NDArray[np.bool_]) -> None:
    if mask.any():
        left_out[reason] = int(mask.sum())


def _with_truth(
    estimate: Estimate, stamps_s: Array, comparable: NDArray[np.bool_], left_out: dict[str, int], truth: Truth
) -> Association:
    rows = complete_rows(truth)
    times_s, poses = rows.stamps_s, rows.w_T_b
    if len(times_s) == 0:
        raise InputError(
            "state_groundtruth_estimate0: holds no complete row; mend it or compare with another flight"
        )
    inside, covered = covered_by(times_s, stamps_s)
    _count(left_out, "outside the truth's time range", comparable & ~inside)
    _count(left_out, "in a gap of the truth", comparable & inside & ~covered)
    keyframe = np.flatnonzero(comparable & inside & covered)
    at_s = np.clip(stamps_s[keyframe], times_s[0], times_s[-1])
    left, right = _neighbours(times_s, at_s)
    w_T_b = _interpolated(times_s, poses, at_s, left, right)
    return Association(
        reference="truth",
        keyframe=keyframe,
        position_m=w_T_b[:, :3, 3].copy(),
        w_T_b=w_T_b,
        left_out=left_out,
        between_rows=_missed_between_rows(times_s, poses, at_s, left, right),
        map_off_line=off_the_chord(estimate, keyframe, at_s, w_T_b, times_s[left], times_s[right]),
        to_row_s=np.minimum(at_s - times_s[left], times_s[right] - at_s),
    )


def complete_rows(truth: Truth) -> Truth:
    """Return the complete rows of the truth in order of time, one for each time."""
    known = _is_complete(truth)
    times_s, first = np.unique(truth.stamps_s[known], return_index=True)
    return Truth(times_s, truth.w_T_b[known][first])


def _is_complete(truth: Truth) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(truth.w_T_b).all(axis=(1, 2)) & np.isfinite(truth.stamps_s))


def incomplete_rows(truth: Truth) -> int:
    """Return the number of rows that hold no whole pose."""
    return int(np.count_nonzero(~_is_complete(truth)))


def covered_by(times_s: Array, stamps_s: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which of ``stamps_s`` (m,) lie within the range of rows at increasing ``times_s`` (n,), and
    which of them on a row or in no gap between two."""
    at_s = np.clip(stamps_s, times_s[0], times_s[-1])
    inside: NDArray[np.bool_] = np.abs(stamps_s - at_s) <= _STAMP_TOLERANCE_S
    left, right = _neighbours(times_s, at_s)
    longest_s = max(_GAP_S, 3 * float(np.median(np.diff(times_s)))) if len(times_s) > 1 else 0.0
    on_a_row: NDArray[np.bool_] = (
        np.minimum(at_s - times_s[left], times_s[right] - at_s) <= _STAMP_TOLERANCE_S
    )
    return inside, (times_s[right] - times_s[left] < longest_s) | on_a_row


def poses_at(truth: Truth, stamps_s: Array) -> Array:
    """Interpolate the truth's poses (n, 4, 4) at any times; outside its time range the end poses are
    returned.

    The rows of the truth must be complete.
    """
    at_s = np.clip(stamps_s, truth.stamps_s[0], truth.stamps_s[-1])
    return _interpolated(truth.stamps_s, truth.w_T_b, at_s, *_neighbours(truth.stamps_s, at_s))


def _neighbours(times_s: Array, at_s: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    right = np.clip(np.searchsorted(times_s, at_s, side="left"), 0, len(times_s) - 1)
    left = np.where(times_s[right] > at_s, np.maximum(right - 1, 0), right)
    return left, right


def _interpolated(
    times_s: Array, poses: Array, at_s: Array, left: NDArray[np.int64], right: NDArray[np.int64]
) -> Array:
    w_T_b = np.tile(np.eye(4), (len(at_s), 1, 1))
    if len(at_s) == 0:
        return w_T_b
    share = _share(times_s, at_s, left, right)[:, None]
    begin_m, end_m = poses[left, :3, 3], poses[right, :3, 3]
    w_T_b[:, :3, 3] = begin_m + share * (end_m - begin_m)  # exact for a vehicle that stands still
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    if len(times_s) == 1:
        w_T_b[:, :3, :3] = rotations.as_matrix()
    else:
        w_T_b[:, :3, :3] = Slerp(times_s, rotations)(at_s).as_matrix()
    return w_T_b


def _share(times_s: Array, at_s: Array, left: NDArray[np.int64], right: NDArray[np.int64]) -> Array:
    """(m,) share of the interval between two rows that has passed; 0 on a row."""
    span_s = times_s[right] - times_s[left]
    return np.divide(at_s - times_s[left], span_s, out=np.zeros_like(at_s), where=span_s > 0)


def _missed_between_rows(
    times_s: Array, poses: Array, at_s: Array, left: NDArray[np.int64], right: NDArray[np.int64]
) -> Array:
    """Errors (m, 2) of the interpolation, in rad and m: u (1 - u) / 2 times the larger adjacent second
    difference.

    Source: error of linear interpolation, h^2 u (1 - u) / 2 times the second derivative.
    """
    if len(times_s) < 3:
        return np.zeros((len(at_s), 2))
    steps = np.diff(times_s)[:, None]
    turned = (
        Rotation.from_matrix(poses[:-1, :3, :3]).inv() * Rotation.from_matrix(poses[1:, :3, :3])
    ).as_rotvec()
    rates = np.hstack([turned, np.diff(poses[:, :3, 3], axis=0)]) / steps
    bent = np.diff(rates, axis=0) / (0.5 * (steps[1:] + steps[:-1]))
    bent = np.linalg.norm(bent.reshape(-1, 2, 3), axis=2)
    # Take the rows at both ends of an interval; the first and the last row use their neighbour's.
    at_row = np.vstack([bent[:1], bent, bent[-1:]])
    share, span_s = _share(times_s, at_s, left, right), times_s[right] - times_s[left]
    return np.asarray(
        (0.5 * share * (1 - share) * span_s**2)[:, None] * np.maximum(at_row[left], at_row[right])
    )


def _with_gps(
    estimate: Estimate,
    flight: Flight,
    stamps_s: Array,
    comparable: NDArray[np.bool_],
    left_out: dict[str, int],
) -> Association:
    gps, origin = flight.gps, estimate.origin or flight.geo_origin()
    check = flight.fix_check()
    known = np.zeros(0, dtype=bool)
    if gps is not None:
        known = np.isfinite(gps.latitude_deg) & np.isfinite(gps.longitude_deg)
    if gps is None or origin is None or check is None or not (known & check.consistent).any():
        raise InputError("gps0: holds no complete fix; mend it or compare with a flight that has truth")
    flat = not np.isfinite(gps.altitude_m[known & check.consistent]).any()
    if not flat:
        known &= np.isfinite(gps.altitude_m)
    agrees = (check.consistent if flat else check.altitude_consistent)[known]
    altitude_m = np.full(int(known.sum()), origin.altitude_m) if flat else gps.altitude_m[known]
    fixes_m = enu_from_geodetic(gps.latitude_deg[known], gps.longitude_deg[known], altitude_m, origin)
    times_s = gps.stamps_s[known]
    half_s = max(0.5 * float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0, _STAMP_TOLERANCE_S)
    after = np.clip(np.searchsorted(times_s, stamps_s), 0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times_s[before] - stamps_s) <= np.abs(times_s[after] - stamps_s), before, after)
    matched = np.abs(times_s[nearest] - stamps_s) <= half_s
    _count(left_out, "without a GPS fix at their time", comparable & ~matched)
    _count(left_out, "whose GPS fix contradicts the other fixes", comparable & matched & ~agrees[nearest])
    matched &= agrees[nearest]
    keyframe = np.flatnonzero(comparable & matched)
    antenna_m = gps.b_T_s[:3, 3] if estimate.antenna_m is None else np.array(estimate.antenna_m)
    position_m = fixes_m[nearest[keyframe]] - estimate.w_T_b[keyframe, :3, :3] @ antenna_m
    return Association(
        reference="gps",
        keyframe=keyframe,
        position_m=position_m,
        w_T_b=None,
        left_out=left_out,
        dimensions=2 if flat else 3,
    )
