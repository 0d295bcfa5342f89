"""Directions of cameras that neither transforms nor names tell, found from their pictures.

A gyro or an attitude says how the vehicle turned and which way is down. The mount of a camera that explains
the turns of its pictures then says where it looks (`frontend.optical_axis`). Without these instruments, the
axis about which the pictures turn on is the vertical (`frontend.turn_axis`). It is decided only where the
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
from slam.io.recordings.recording import Burst, Offer, Recording, Watch

Array = NDArray[np.float64]

ODDS = 1000.0
"""Odds at which it counts as known where a camera looks: ten times those that are called decisive (Jeffreys
1961, Theory of Probability, appendix B), since a map of the wrong camera is worth nothing."""


@dataclass(frozen=True)
class CameraLook:
    """The direction of a camera by its pictures."""

    look: Look
    sentence: str
    """A sentence with the evidence, or with the reason why the pictures do not tell."""
    tilt_deg: float = np.nan
    """Angle to straight down; NaN where the pictures do not tell."""

    @staticmethod
    def of(evidence: Array, tilt_rad: float, down: str, vertical: str, how: str) -> CameraLook:
        """Return what the evidence (n,) for a camera that looks down decides.

        ``down`` and ``vertical`` name the direction that was compared, and ``how`` the means.
        """
        how, tilt_deg = f"{how} in {len(evidence)} stretches", float(np.degrees(tilt_rad))
        for look, name, sign in ((Look.DOWN, down, 1.0), (Look.ASIDE, "aside", -1.0)):
            if is_decisive(sign * evidence):
                return CameraLook(
                    look, f"looks {name}, {tilt_deg:.0f} degrees from {vertical}, by {how}", tilt_deg
                )
        return CameraLook(Look.UNKNOWN, f"{how} do not tell where it looks")


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
            return [f"cam0: by its pictures it {tilt_remark(view.tilt_deg)}"]
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
        view = _look(recording.watch, min(device, key=lambda offer: offer.rank))
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
    return replace(offer, look=look, view=view.sentence)


def _device(offer: Offer) -> str:
    return offer.device or offer.channel


def _look(watch: Watch, offer: Offer) -> CameraLook:
    """Return where a camera looks by the instruments, or where they do not tell, by the pictures alone."""
    watched = watch(offer, False)
    if watched is None:
        return CameraLook(Look.UNKNOWN, "its lens is unknown")
    by_instruments = look_by_instruments(*watched)
    alone = watch(offer, True) if by_instruments.look == Look.UNKNOWN else None
    if alone is None:
        return by_instruments
    by_pictures = look_by_pictures(*alone)
    if by_pictures.look != Look.UNKNOWN:
        return by_pictures
    return CameraLook(Look.UNKNOWN, f"{by_instruments.sentence}, and {by_pictures.sentence}")


def look_by_instruments(camera: Camera, bursts: Iterable[Burst]) -> CameraLook:
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
        return CameraLook(Look.UNKNOWN, "no gyro or attitude shows how the vehicle turned")
    if not pairs:
        return CameraLook(Look.UNKNOWN, "its pictures have too little in common to tell where it looks")
    b_down = -np.median(up, axis=0)
    evidence = axis_evidence(pairs, b_down, np.radians(MAX_TILT_DEG), stretches)
    return CameraLook.of(evidence.by_block, evidence.tilt_rad, "down", "straight down", "its turns")


def look_by_pictures(camera: Camera, bursts: Iterable[Burst]) -> CameraLook:
    """Return where a camera looks by the axis about which its pictures turn."""
    from frontend.ray_pairs import ray_pairs, threshold_rad
    from frontend.turn_axis import step_turns, vertical_evidence

    chains = []
    for burst in bursts:
        steps: list[list[Array]] = []
        for k, rays in ray_pairs(burst.pictures, camera, successive=True):
            turns = step_turns(rays, threshold_rad(camera))
            if k != len(steps) + 1 or not turns:
                break
            steps.append(turns)
        if steps:
            chains.append(steps)
    if not chains:
        return CameraLook(Look.UNKNOWN, "its pictures have too little in common to tell where it looks")
    evidence, tilt_rad = vertical_evidence(chains, np.radians(MAX_TILT_DEG))
    how = "the axis about which its pictures turn"
    return CameraLook.of(evidence, tilt_rad, "down (or up)", "the vertical", how)


def is_decisive(evidence: Sequence[float] | Array) -> bool:
    """Return whether stretches (n,) decide for the first of two explanations, from twice the difference of
    their log-likelihoods.

    The likelihoods must differ by the odds. So must the stretches agree: errors within one are related. If
    both explanations were equally good, stretches would favour the first one so clearly once in so many
    recordings. Source: Clarke 2007 (Political Analysis 15) for a test without a distribution; Wilcoxon 1945
    (Biometrics Bulletin 1) for the signed ranks.
    """
    evidence = np.asarray(evidence)
    if evidence.sum() < 2.0 * np.log(ODDS):
        return False
    from scipy.stats import wilcoxon

    return bool(wilcoxon(evidence, alternative="greater").pvalue < 1.0 / ODDS)
