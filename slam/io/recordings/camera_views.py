"""Directions of cameras that neither transforms nor names tell, found from their pictures.

A gyro or an attitude says how the vehicle turned and which way is down. The mount of a camera that explains
the turns of its pictures then says where it looks (`frontend.optical_axis`). It is decided only where the
evidence is decisive; a vehicle that hardly turns leaves it open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.names import listed
from slam.core.progress import Progress
from slam.io.down_looking import MAX_TILT_DEG, Look, tilt_remark
from slam.io.recordings.recording import Burst, Offer, Recording

Array = NDArray[np.float64]

ODDS = 1000.0
"""Odds at which it counts as known where a camera looks: ten times those that are called decisive (Jeffreys
1961, Theory of Probability, appendix B), since a map of the wrong camera is worth nothing."""


@dataclass(frozen=True)
class CameraLook:
    """The direction of a camera by its pictures."""

    look: Look
    tilt_deg: float = np.nan
    """Angle to straight down; NaN where the pictures do not tell."""
    stretches: int = 0
    """Number of stretches of the recording that were compared."""
    why: str = ""
    """Reason why the pictures do not tell."""

    def sentence(self) -> str:
        """Say it with the evidence, for the table of channels."""
        if self.look == Look.UNKNOWN:
            return self.why
        where = "down" if self.look == Look.DOWN else "aside"
        return (
            f"looks {where}, {self.tilt_deg:.0f} degrees from straight down, by its turns in "
            f"{self.stretches} stretches"
        )


@dataclass(frozen=True)
class Judged:
    """A recording whose cameras are told apart, as far as their pictures do."""

    recording: Recording
    views: Mapping[str, CameraLook]
    """Channel -> what its pictures tell; empty where nothing was in question."""

    def remarks(self, channel: str | None) -> list[str]:
        """Return a warning about the chosen camera where it may be the wrong one."""
        if channel is None or channel not in self.views:
            return []
        view = self.views[channel]
        if view.look == Look.DOWN:
            return []
        if view.look == Look.ASIDE:
            return [f"cam0: by the turns of its pictures it {tilt_remark(view.tilt_deg)}"]
        others = [name for name, other in self.views.items() if other is not view and other.look == view.look]
        open_ = f"which of {channel} and {listed(others, 4)} looks" if others else f"whether {channel} looks"
        return [
            f"cam0: neither a transform, a name nor the pictures tell {open_} down; {channel} is taken: name "
            "another one by --topic cam0=CHANNEL, or record /tf_static"
        ]


def judged(recording: Recording, topics: Mapping[str, str], progress: Progress) -> Judged:
    """Find out from the pictures which camera looks down, where nothing else tells and none is named."""
    cameras = [offer for offer in recording.offers if offer.stream == "cam0" and offer.rows]
    likely = min((offer.look for offer in cameras), default=Look.DOWN)
    rivals = [offer for offer in cameras if offer.look == likely and not offer.is_declared]
    if "cam0" in topics or likely == Look.DOWN or recording.watch is None:
        return Judged(recording, {})
    devices = [list(same) for _, same in groupby(sorted(rivals, key=_device), key=_device)]
    if len(devices) < 2:
        return Judged(recording, {})
    views: dict[str, CameraLook] = {}
    for k, device in enumerate(devices):
        progress("looking where the cameras look", k, len(devices))
        shown = min(device, key=lambda offer: offer.rank)
        watched = recording.watch(shown)
        view = CameraLook(Look.UNKNOWN, why="its lens is unknown") if watched is None else view_of(*watched)
        views |= {offer.channel: view for offer in device}
    progress("looking where the cameras look", len(devices), len(devices))
    offers = [
        _seen(offer, views[offer.channel]) if offer.stream == "cam0" and offer.channel in views else offer
        for offer in recording.offers
    ]
    return Judged(replace(recording, offers=tuple(offers)), views)


def _seen(offer: Offer, view: CameraLook) -> Offer:
    """Return a camera with what its pictures tell; where they do not tell, its name still does."""
    look = offer.look if view.look == Look.UNKNOWN else view.look
    return replace(offer, look=look, view=view.sentence())


def _device(offer: Offer) -> str:
    return offer.device or offer.channel


def view_of(camera: Camera, bursts: Iterable[Burst]) -> CameraLook:
    """Return where a camera looks by its turns and those of the vehicle."""
    from frontend.optical_axis import TurnedPair, axis_evidence
    from frontend.ray_pairs import ray_pairs

    pairs: list[TurnedPair] = []
    up: list[Array] = []
    stretches = 0
    for burst in bursts:
        if burst.w_R_b is None or burst.b_up is None:
            continue
        found = ray_pairs(burst.pictures, camera)
        pairs += [TurnedPair(rays, burst.w_R_b[k].T @ burst.w_R_b[0], stretches) for k, rays in found]
        up.append(burst.b_up)
        stretches += bool(found)
    if not up:
        return CameraLook(Look.UNKNOWN, why="no gyro or attitude shows how the vehicle turned")
    undecided = CameraLook(Look.UNKNOWN, why=f"its turns in {stretches} stretches do not tell where it looks")
    if stretches < 2:
        return undecided
    b_down = -np.median(up, axis=0)
    evidence = axis_evidence(pairs, b_down, np.radians(MAX_TILT_DEG), stretches)
    if is_decisive(evidence.by_block):
        look = Look.DOWN
    elif is_decisive(-evidence.by_block):
        look = Look.ASIDE
    else:
        return undecided
    return CameraLook(look, float(np.degrees(evidence.tilt_rad)), stretches)


def is_decisive(evidence: Sequence[float] | Array) -> bool:
    """Return whether stretches (n,) decide for the first of two explanations, from twice the difference of
    their log-likelihoods.

    The likelihoods must differ by the odds. So must the stretches agree: errors within one are related, and
    if both explanations were equally good, such a mean of the stretches would be found once in so many
    recordings. Source: Vuong 1989 (Econometrica 57), with Student's distribution for few stretches.
    """
    from scipy.special import stdtr

    evidence = np.asarray(evidence)
    mean, n = float(evidence.mean()), len(evidence)
    if n * mean < 2.0 * np.log(ODDS):
        return False
    error = float(evidence.std(ddof=1)) / np.sqrt(n)
    return error == 0.0 or bool(stdtr(n - 1, -mean / error) < 1.0 / ODDS)
