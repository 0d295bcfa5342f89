"""Doubts about the floor's motion that pictures leave open: a floor that repeats, and a second motion.

Registrations of a repeating floor agree with each other on a wrong copy as well as on the right one. Of the
copies, that nearest to the prediction is taken. It is the right one if the prediction errs by less than half
a period. How much it errs is visible: the pictures show the error, less a whole number of periods.

Of two motions in the pictures the one that covers more is taken for the floor's. It may be that of a train, a
conveyor or a crowd.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from frontend.camera import Camera
from frontend.corner_track import FloorHomography
from frontend.homography import transfer
from frontend.motions import KNOWN_MOTION_WIDTHS, OtherMotion
from frontend.registration import Registration
from frontend.repetition import Repetition, repetition
from frontend.second_motion import second_motion
from slam.mapping.front_end import FrontEnd, Observations

Array = NDArray[np.float64]

_LOOKED_AT = 40
"""Keyframes that are looked at, evenly over the flight: 3 ms each."""
_REPEATING_SHARE = 0.1
"""Least share of these that repeat: a single row of equal things is no floor that repeats."""
LIKELY_WRONG = 0.25
"""Expected number of wrong copies from which on a map may not be called right."""
_RELIEF = 1.5
"""Most that ground at another height moves faster or slower than the floor: at a third of the camera's
height above it."""
_ASIDE = 0.35
"""Most that it moves aside, of the difference: a tilt by 5 degrees turns the way of a keyframe by 20."""
_LARGE, _OFTEN, _LASTING = 0.4, 0.1, 0.5
"""A second motion may be the floor's if it covers so much of what moves, two parts of five, in this share of
the pictures; or at any size if it is seen in half of the keyframes, as a floor at the edge of a train is."""
_MOST = 0.5
"""Share of the second motions above which they are no ground at another height: where the two differ by few
pixels, a fit to both may go any way."""
_AGREEING = 0.9
"""Share of the steps where the instruments agree with the motion that was taken for the floor's."""


@dataclass(frozen=True)
class RepeatingFloor:
    """A floor that looks alike one period away."""

    keyframes: NDArray[np.int64]
    """Keyframes that show it, of those looked at."""
    looked_at: int
    period_px: Array
    """(k,) shortest distance of two copies in each of these."""
    wrong: float
    """Expected number of steps between pictures that lead to a wrong copy."""


@dataclass(frozen=True)
class TwoMotions:
    """Two motions in the pictures, either of which may be the floor's."""

    frames: NDArray[np.int64]
    """Frames that show both."""
    share: float
    """Share of what moves that the lesser motion covers, in the median."""


@dataclass(frozen=True)
class FloorDoubts:
    """Doubts about the floor's motion in the pictures of a flight."""

    repeating: RepeatingFloor | None = None
    two_motions: TwoMotions | None = None
    sure_px: float = 0.0
    """Error of a step within which instruments tell which of the motions is the floor's."""

    @property
    def are_open(self) -> bool:
        """Whether the pictures alone may have led to a wrong map."""
        wrong = self.repeating.wrong if self.repeating else 0.0
        return self.two_motions is not None or wrong >= LIKELY_WRONG

    @property
    def is_floor_known(self) -> bool:
        """Whether the floor neither repeats nor is one of two motions."""
        return self.repeating is None and self.two_motions is None


def floor_doubts(observations: Observations, front_end: FrontEnd) -> FloorDoubts:
    """Return what the pictures leave open.

    Photographs are registered without a prediction. A second motion is not searched in them: over the height
    differences of oblique ones, ground moves in many directions.
    """
    camera, told = front_end.camera, front_end.views if observations.by_instruments else None
    are_photographs = front_end.flight.all_keyframes
    steps = list(_steps(observations, camera, told, not are_photographs))
    found = _repetitions(observations, camera, front_end.config.gates.min_inliers)
    repeating = {k: one for k, one in found.items() if one is not None}
    if len(repeating) > max(1.0, _REPEATING_SHARE * len(found)):
        floor = _repeating(repeating, len(found), steps)
        return FloorDoubts(floor, None, 0.5 * float(np.median(floor.period_px)))
    if are_photographs:
        return FloorDoubts()
    both = _two_motions(observations, front_end, steps, told is not None)
    return FloorDoubts(None, both, KNOWN_MOTION_WIDTHS * camera.size_px[0])


class _Step(NamedTuple):
    """Displacement of the middle of a picture since the one before."""

    keyframe: int
    off_px: Array
    """(2,) from its prediction, or from the picture before where nothing predicts it."""
    is_predicted: bool


def _steps(
    observations: Observations, camera: Camera, told: FloorHomography | None, continues: bool
) -> Iterator[_Step]:
    """Yield the steps from each registered frame to the next, in the picture of a keyframe.

    ``continues``: whether each step was expected to go on as the one before, where no instrument told it.
    """
    stamps_s, middle = observations.frame_stamps_s, 0.5 * np.array([camera.size_px], dtype=np.float64)
    before: tuple[Array, float] | None = None
    for k, frames in enumerate(observations.registered()):
        link = observations.links[k]
        if link is None:
            before = None
        elif before is not None:
            before = transfer(np.asarray(np.linalg.inv(link.i_H_j), dtype=float), before[0]), before[1]
        for here, there in pairwise(frames):
            if there.frame == here.frame:
                continue
            at, to = (transfer(each.i_H_j, middle) for each in (here, there))
            now_s, next_s = stamps_s[here.frame], stamps_s[there.frame]
            if told is not None:
                step = np.linalg.inv(told(here.frame)) @ told(there.frame)
                expected = transfer(here.i_H_j @ step, middle)
            elif continues and before is not None and now_s > before[1]:
                expected = at + (at - before[0]) * (next_s - now_s) / (now_s - before[1])
            else:
                expected = None
            off = to - (at if expected is None else expected)
            yield _Step(k, off[0], expected is not None)
            before = at, now_s


def _repetitions(observations: Observations, camera: Camera, least: int) -> dict[int, Repetition | None]:
    """Return the repetition of keyframes that are linked to the next one."""
    store = observations.store
    return {
        link.i: repetition(store[link.i], store[link.j], link, camera.size_px, least)
        for link in _looked_at(observations)
    }


def _looked_at(observations: Observations) -> list[Registration]:
    links = [link for link in observations.links if link is not None and not link.by_lines]
    return links[:: -(-len(links) // _LOOKED_AT)] if links else []


def _repeating(found: dict[int, Repetition], looked_at: int, steps: list[_Step]) -> RepeatingFloor:
    """Return the floor with the number of wrong copies that is expected."""
    keyframes = np.array(sorted(found), dtype=np.int64)
    off, wrong = list[Array](), 0.0
    for step in steps:
        lattice = found[int(keyframes[np.abs(keyframes - step.keyframe).argmin()])]
        periods = lattice.in_periods(step.off_px[None])[0]
        if step.is_predicted:
            off.append(periods)
        else:
            # Of a motion of any size, that of x periods is as probable as 1 / x, and x may be x - 1.
            wrong += float(np.abs(periods - np.round(periods)).max())
    wrong += len(off) * _share_wrong(off)
    return RepeatingFloor(keyframes, looked_at, np.array([found[k].period_px for k in keyframes]), wrong)


def _share_wrong(off: list[Array]) -> float:
    """Return the share of displacements beyond half a period, from those that are known up to a period.

    Their standard deviation s follows from the mean cosine of the phase, which is exp(-2 pi² s²) for a normal
    distribution that is wrapped around. Source: Mardia and Jupp 2000, section 3.5.7.
    """
    if not off:
        return 0.0
    components = max(len(each) for each in off)
    shares = []
    for axis in range(components):
        phase = np.array([each[axis] for each in off if len(each) > axis])
        mean = np.clip(np.cos(2 * np.pi * phase).mean(), 1e-9, 1.0)
        std = np.sqrt(-np.log(mean) / (2 * np.pi**2))
        shares.append(2 * ndtr(-0.5 / max(std, 1e-9)))
    return float(max(shares))


def _two_motions(
    observations: Observations, front_end: FrontEnd, steps: list[_Step], by_instruments: bool
) -> TwoMotions | None:
    """Return the second motion if it may be the floor's and the instruments do not tell."""
    within_px = KNOWN_MOTION_WIDTHS * front_end.camera.size_px[0]
    links = _beside_links(observations, front_end)
    in_links = {k: other for k, other in links.items() if other is not None}
    seen = in_links | dict(observations.moving)
    both = {k: other for k, other in seen.items() if not _belongs(other, within_px)}
    large = sum(other.share >= _LARGE for other in both.values()) > _OFTEN * observations.frames
    lasting = len(both.keys() & in_links) > _LASTING * len(links)
    if not (large or lasting) or len(both) <= _MOST * len(seen):
        return None
    if by_instruments and np.mean([np.hypot(*step.off_px) <= within_px for step in steps]) >= _AGREEING:
        return None
    share = float(np.median([other.share for other in both.values()]))
    return TwoMotions(np.array(sorted(both), dtype=np.int64), min(share, 1 - share))


def _beside_links(observations: Observations, front_end: FrontEnd) -> dict[int, OtherMotion | None]:
    """Return the second motion in links between keyframes, by the frame of the later one."""
    store, config, found = observations.store, front_end.config, dict[int, OtherMotion | None]()
    for link in _looked_at(observations):
        frame = int(observations.frame_index[link.j])
        found[frame] = observations.moving.get(frame) or second_motion(
            store[link.i], store[link.j], link, front_end.camera, front_end.homography,
            config.gates.min_inliers,
        )  # fmt: skip
    return found


def _belongs(other: OtherMotion, within_px: float) -> bool:
    """Return whether a second motion is that of the ground at another height, or of the camera itself.

    Ground at another height goes the way of the floor, faster or slower, beside a turn that both have. What
    is fixed to the camera does not move.
    """
    moved, floor, way = (np.array(each) for each in (other.moved_px, other.floor_px, other.middle_px))
    if np.linalg.norm(moved) <= within_px:
        return bool(np.linalg.norm(floor) > within_px)
    off, length = moved - floor, float(np.linalg.norm(way))
    if length <= within_px:
        return False
    along = 1 + off @ way / length**2
    aside_px = abs(off[0] * way[1] - off[1] * way[0]) / length
    is_way = aside_px <= max(within_px, _ASIDE * np.linalg.norm(off))
    return bool(is_way and 1 / _RELIEF <= along <= _RELIEF)
