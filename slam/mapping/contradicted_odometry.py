"""Find the step of odometry that pairs of pictures contradict by one common displacement.

One false step puts all that follows elsewhere, so that every true loop over it lies elsewhere than the poses
have it. The covariances of odometry know nothing of a false step. False loops over a floor that repeats share
a displacement too. There the pictures match where the odometry has them as well, which a second look shows;
over a false step they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.measurements import LinkCheck, Misfit, Rejection, RelativePose
from frontend.loops import verify
from frontend.motions import Expectation
from frontend.registration import overlap
from slam.core.units import unit
from slam.mapping.contradicted_step import ContradictedStep
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.map import Map
from slam.mapping.search_radius import KnownPoses, Misplacements

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LOOKS = 300
"""Pairs that are looked at again, and displacements that are compared with all; of more, each n-th."""
_WEAK = 0.5
"""Share of the usual information of a step below which odometry is weak there."""


def contradicted_step(
    front_end: FrontEnd, chain: Map, found: Observations, edges: Sequence[RelativePose]
) -> ContradictedStep | None:
    """Return the step of the ``chain`` that pairs of pictures contradict; None if none does.

    ``edges``: the registrations ``found``, in the unit of the chain.
    """
    known, odometry = chain.known_poses(), {(r.i, r.j) for r in chain.observations.registrations}
    loops = [edge for edge in edges if (edge.i, edge.j) not in odometry]
    if known.covariances is None or not loops:
        return None
    placed = Misplacements.of(loops, known, front_end.config.loops)
    group = _largest_group(loops, known, placed)
    if not group.any():
        return None
    every = -(-int(np.count_nonzero(group)) // _LOOKS)
    looked = group & (np.cumsum(group) % every == 0)
    absent, present = _second_look(front_end, chain, found, loops, looked)
    low, high = np.array([(edge.i, edge.j) for edge in loops]).T
    agreeing = present | (placed.is_known & ~placed.beyond)
    votes = _spanning(len(known.w_T_b), low, high, every * absent.astype(np.float64) - agreeing)
    trusted = [edge for edge in edges if (edge.i, edge.j) in odometry]
    stretch = _weakest_stretch(votes, trusted)
    if stretch is None:
        return None
    first, last = stretch
    over = group & (low <= first) & (high >= last)
    links = sum(edge.i <= first and edge.j > first for edge in trusted)
    turn = se3.log(_displacements(loops, known)[over])[:, :3]
    return ContradictedStep(
        pairs=int(np.count_nonzero(over)),
        off=Misfit(
            float(np.median(placed.off[over])),
            unit(known.metric),
            float(np.degrees(np.median(np.linalg.norm(turn, axis=1)))),
        ),
        between=(int(low[over].max()), int(high[over].min())),
        weakest=stretch,
        left_out=bool(every * np.count_nonzero(absent & over) > links),
    )


def without_step(observations: Observations, chain: Map, step: ContradictedStep) -> Observations:
    """Return the observations with the step noted, and without its odometry if that is left out."""
    observations = replace(observations, contradicted_steps=(*observations.contradicted_steps, step))
    if not step.left_out:
        return observations
    first, last = step.weakest
    reason = Rejection(LinkCheck.PLACE, f"{step.off.length:.2f} {step.off.unit} from where loops put it")
    over = {(r.i, r.j): reason for r in chain.observations.registrations if r.i < last and first < r.j}
    links = tuple(None if link and (link.i, link.j) in over else link for link in observations.links)
    return replace(observations.without(over), links=links)


def _displacements(loops: Sequence[RelativePose], known: KnownPoses) -> Array:
    """Return (m, 4, 4) transforms of the world from where the poses have j to where the loops put it."""
    i, j = np.array([(edge.i, edge.j) for edge in loops]).T
    measured = known.w_T_b[i] @ np.array([edge.i_T_j for edge in loops])
    return np.asarray(measured @ se3.inverse(known.w_T_b[j]))


def _largest_group(loops: Sequence[RelativePose], known: KnownPoses, placed: Misplacements) -> Mask:
    """Return the most implausible loops (m,) that one displacement of all that follows makes plausible."""
    best = np.zeros(len(loops), dtype=bool)
    beyond = np.flatnonzero(placed.beyond)
    if len(beyond) == 0:
        return best
    implausible = [loops[m] for m in beyond.tolist()]
    apart, there = _displacements(implausible, known), known.w_T_b[[edge.j for edge in implausible]][:, :, 3]
    measured = np.einsum("mab,mb->ma", apart, there)
    for seed in range(0, len(beyond), -(-len(beyond) // _LOOKS)):
        off = np.linalg.norm(measured - there @ apart[seed].T, axis=1)
        agreeing = beyond[off <= placed.limit[beyond]]
        if len(agreeing) > np.count_nonzero(best):
            best[:] = False
            best[agreeing] = True
    return best


def _second_look(
    front_end: FrontEnd, chain: Map, found: Observations, loops: Sequence[RelativePose], among: Mask
) -> tuple[Mask, Mask]:
    """Look for each pair ``among`` loops (m,) where odometry has it: (m,) not there, and (m,) there too.

    Pairs whose pictures do not overlap there tell nothing.
    """
    camera, corners_px = front_end.camera, front_end.camera.undistort(front_end.camera.corners_px)
    first = {(r.i, r.j): r for r in found.registrations}
    expected: dict[tuple[int, int], Expectation] = {}
    number: dict[tuple[int, int], int] = {}
    for m in np.flatnonzero(among).tolist():
        pair = loops[m].i, loops[m].j
        here, there = (camera.floor_H_image(chain.over_floor_T_b[k], chain.floor_z_m) for k in pair)
        i_H_j = np.linalg.inv(here) @ there
        at = Expectation.at(i_H_j, corners_px)
        if at is not None and overlap(i_H_j, camera) >= front_end.config.loops.min_overlap:
            expected[pair], number[pair] = at, m
    absent, present = np.zeros_like(among), np.zeros_like(among)
    verdicts = verify(
        list(expected), found.store, camera, front_end.homography, front_end.config.gates,
        expected=lambda i, j: expected[i, j],
    )  # fmt: skip
    for r in verdicts:
        at = expected[r.i, r.j]
        is_there = r.ok and at.off_px(r.i_H_j, corners_px) < 0.5 * at.off_px(
            first[r.i, r.j].i_H_j, corners_px
        )
        (present if is_there else absent)[number[r.i, r.j]] = True
    return absent, present


def _weakest_stretch(votes: Array, trusted: Sequence[RelativePose]) -> tuple[int, int] | None:
    """Return the keyframes around the weakest odometry among the steps (n - 1,) with the most votes."""
    if len(votes) == 0 or votes.max() <= 0:
        return None
    low, high = np.array([(edge.i, edge.j) for edge in trusted]).T
    certainty = np.array([1 / np.trace(edge.covariance[3:, 3:]) for edge in trusted])
    information = _spanning(len(votes) + 1, low, high, certainty)
    most = votes == votes.max()
    first = int(np.argmin(np.where(most & (information > 0), information, np.inf)))
    last = first + 1
    weak = most & (information < _WEAK * np.median(information))
    while first > 0 and weak[first - 1]:
        first -= 1
    while last < len(weak) and weak[last]:
        last += 1
    return first, last


def _spanning(count: int, low: Index, high: Index, weight: Array) -> Array:
    """Return (count - 1,) the sum of the weights of the edges over each step to the next keyframe."""
    change = np.zeros(count + 1)
    np.add.at(change, low, weight)
    np.add.at(change, high, -weight)
    return np.asarray(np.cumsum(change)[: count - 1])
