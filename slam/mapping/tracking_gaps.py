"""Links across a gap: the first picture after a stretch without features, matched to the last one before it.

Nothing was seen in between, so that over a repetitive floor the match may be one tile off, and with it all
that follows. Where the instruments measured the motion across the gap more precisely, they decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backend import se3
from backend.measurements import LinkCheck, Rejection, RelativePose
from backend.quantiles import chi_square_quantile
from slam.mapping.front_end import Observations
from slam.mapping.inertial.bridges import InertialBridges
from slam.mapping.lift_edges import lift_edges

_LEAST_S = 0.5
"""Without a picture for so long a vehicle of 1 m/s has gone on by half of what it sees from 0.8 m."""
_INTERVALS = 3
"""Pictures that are always so far apart are no break."""
_SURE = 1 - 1e-4
"""Share of true links that agree with the instruments."""


@dataclass(frozen=True)
class TrackingGap:
    """A long time without a picture of use between two linked keyframes."""

    pair: tuple[int, int]
    """The keyframes (i, j)."""
    before: int
    """The last frame before it."""


def tracking_gaps(observations: Observations) -> tuple[TrackingGap, ...]:
    """Find links across a gap in the pictures; frames behind the gap may be registered to the keyframe
    before it."""
    stamps_s = observations.frame_stamps_s
    if len(stamps_s) < 2:
        return ()
    least_s = max(_LEAST_S, _INTERVALS * float(np.median(np.diff(stamps_s))))
    registered = observations.registered()
    found = []
    for link in observations.links:
        if link is not None:
            frames = np.array([row.frame for row in registered[link.i]])
            steps_s = np.diff(stamps_s[frames])
            longest = int(np.argmax(steps_s))
            found += (
                [TrackingGap((link.i, link.j), int(frames[longest]))] if steps_s[longest] > least_s else []
            )
    return tuple(found)


def contradicted(
    breaks: Sequence[TrackingGap], lifted: Sequence[RelativePose], inertial: Sequence[RelativePose]
) -> dict[TrackingGap, Rejection]:
    """Return the links over ``breaks``, ``lifted`` to metres, that contradict the ``inertial`` edges, with
    reasons."""
    inertial_of = {(edge.i, edge.j): edge for edge in inertial}
    pose_of = {(pose.i, pose.j): pose for pose in lifted}
    reasons = {}
    for broken in breaks:
        if broken.pair not in inertial_of or broken.pair not in pose_of:
            continue
        edge, pose = inertial_of[broken.pair], pose_of[broken.pair]
        off = se3.log(se3.inverse(edge.i_T_j[None]) @ pose.i_T_j)[0]
        if off @ np.linalg.solve(edge.covariance + pose.covariance, off) > chi_square_quantile(_SURE, 6):
            off_m = float(np.linalg.norm(off[3:]))
            reasons[broken] = Rejection(
                LinkCheck.PLACE,
                f"{off_m:.2f} m from where the instruments put it, across a gap in the pictures",
            )
    return reasons


def without_false_links(observations: Observations, bridges: InertialBridges) -> Observations:
    """Return the observations without links over breaks that contradict the instruments."""
    breaks = tracking_gaps(observations)
    if not breaks:
        return observations
    lifted = lift_edges([link for link in observations.links if link is not None], bridges.setup)
    gaps = bridges.without([broken.pair for broken in breaks]).gaps()
    poses = lifted.relative_poses if gaps.heights is None else lifted.at_heights(gaps.heights.height_m)
    return remove_links(observations, contradicted(breaks, poses, gaps.edges))


def remove_links(observations: Observations, reasons: Mapping[TrackingGap, Rejection]) -> Observations:
    """Return the observations without the links over some breaks, each rejected for its reason. Tracking
    starts anew behind them, and the poses of the frames between are unknown."""
    pairs = {broken.pair: reason for broken, reason in reasons.items()}
    before = {broken.pair[0]: broken.before for broken in reasons}
    links = tuple(None if link and (link.i, link.j) in pairs else link for link in observations.links)
    passed = tuple(p for p in observations.passed if p.frame <= before.get(p.keyframe, p.frame))
    return replace(observations.without(pairs), links=links, passed=passed)
