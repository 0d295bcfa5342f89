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

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.messages import Message, about, warning
from slam.core.names import listed
from slam.core.progress import Progress
from slam.io.down_looking import MAX_TILT_DEG, NOSE_AT_TOP, Look, axis_tilt_deg, tilt_remark
from slam.io.recordings.recording import Burst, Offer, PictureChannel, Recording, Watch

Array = NDArray[np.float64]

ODDS = 1000.0
"""Odds at which it counts as known where a camera looks: ten times those that are called decisive (Jeffreys
1961, Theory of Probability, appendix B), since a map of the wrong camera is worth nothing."""


_LEFT = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Quarter turn to the left, of level coordinates."""


@dataclass(frozen=True)
class CameraLook:
    """The direction of a camera by its pictures."""

    look: Look
    sentence: str
    """A sentence with the evidence, or with the reason why the pictures do not tell."""
    tilt_deg: float = np.nan
    """Angle to straight down; NaN where the pictures do not tell."""
    quarter_turns: int = 0
    """Quarter turns to the left, -1 to 2, by which the top of the picture is surely off the nose."""

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

    def remarks(self, channel: str | None) -> list[Message]:
        """Return a warning about the chosen camera where it may be the wrong one."""
        if channel is None or channel not in self.views:
            return []
        view = self.views[channel]
        if view.look == Look.DOWN:
            return []
        if view.look == Look.ASIDE:
            return [tilt_remark(view.tilt_deg).prefixed("by its pictures it").named("cam0")]
        others = [name for name, other in self.views.items() if other is not view and other.look == view.look]
        open_ = f"which of {channel} and {listed(others, 4)} looks" if others else f"whether {channel} looks"
        return [
            about(
                "cam0",
                f"neither a transform, a name nor the pictures tell {open_} down",
                f"{channel} is taken: name another one by --topic cam0=CHANNEL, or record /tf_static",
            )
        ]

    def mounted(self, channel: str | None, pictures: PictureChannel | None) -> PictureChannel | None:
        """Return the pictures with the mount that the turns show, to a quarter turn, instead of an assumed
        one."""
        view = self.views.get(channel or "")
        if pictures is None or view is None or not view.quarter_turns:
            return pictures
        side = {1: "left", -1: "right", 2: "rear"}[view.quarter_turns]
        line = warning(
            f"no fixed transform to the body: by its turns the top of its pictures is at the {side} of the "
            "vehicle, and its mount is taken so",
            "record /tf_static to have it exactly",
        )
        b_T_c = NADIR_B_T_C.copy()
        b_T_c[:2] = np.linalg.matrix_power(_LEFT, view.quarter_turns % 4) @ b_T_c[:2]
        notes = tuple(line if note == NOSE_AT_TOP else note for note in pictures.notes)
        return replace(pictures, camera=replace(pictures.camera, b_T_c=b_T_c), notes=notes)


def judged(recording: Recording, topics: Mapping[str, str], progress: Progress) -> Judged:
    """Find out from the pictures which camera looks down, where nothing else tells and none is named.

    Of a single camera it is checked by the instruments alone, since it is assumed to look down anyway.
    """
    cameras = [offer for offer in recording.offers if offer.stream == "cam0" and offer.rows]
    likely = min((offer.look for offer in cameras), default=Look.DOWN)
    rivals = [offer for offer in cameras if offer.look == likely and not offer.is_declared]
    if "cam0" in topics or likely == Look.DOWN or recording.watch is None:
        return Judged(recording, {})
    devices = [list(same) for _, same in groupby(sorted(rivals, key=_device), key=_device)]
    is_single = len(devices) == 1
    views: dict[str, CameraLook] = {}
    for k, device in enumerate(devices):
        progress("looking where the cameras look", k, len(devices))
        view = _look(recording.watch, min(device, key=lambda offer: offer.rank), is_single)
        if not is_single or view.look != Look.UNKNOWN:
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


def _look(watch: Watch, offer: Offer, by_instruments_alone: bool) -> CameraLook:
    """Return where a camera looks by the instruments, or where they do not tell, by the pictures alone."""
    watched = watch(offer, False)
    if watched is None:
        return CameraLook(Look.UNKNOWN, "its lens is unknown")
    by_instruments = look_by_instruments(*watched)
    if by_instruments_alone or by_instruments.look != Look.UNKNOWN:
        return by_instruments
    alone = watch(offer, True)
    if alone is None:
        return by_instruments
    by_pictures = look_by_pictures(*alone)
    if by_pictures.look != Look.UNKNOWN:
        return by_pictures
    return CameraLook(Look.UNKNOWN, f"{by_instruments.sentence}, and {by_pictures.sentence}")


def look_by_instruments(camera: Camera, bursts: Iterable[Burst]) -> CameraLook:
    """Return where a camera looks by its turns and those of the vehicle."""
    from frontend.optical_axis import TurnedPair, axis_evidence, quarter_turns, top_evidence
    from frontend.ray_pairs import ray_pairs

    pairs: list[TurnedPair] = []
    up: list[Array] = []
    stretches = 0
    for burst in bursts:
        if burst.w_R_b is None or burst.b_up is None:
            continue
        matched = ray_pairs(burst.pictures, camera)
        pairs += [TurnedPair(rays, burst.w_R_b[k].T @ burst.w_R_b[0], stretches) for k, rays in matched]
        up.append(burst.b_up)
        stretches += bool(matched)
    if not up:
        return CameraLook(Look.UNKNOWN, "no gyro or attitude shows how the vehicle turned")
    if not pairs:
        return CameraLook(Look.UNKNOWN, "its pictures have too little in common to tell where it looks")
    b_down = -np.median(up, axis=0)
    evidence = axis_evidence(pairs, b_down, np.radians(MAX_TILT_DEG), stretches)
    found = CameraLook.of(evidence.by_block, evidence.tilt_rad, "down", "straight down", "its turns")
    if found.look != Look.DOWN or axis_tilt_deg(b_down) > MAX_TILT_DEG:
        return found
    turned = is_decisive(top_evidence(pairs, evidence.b_R_c, stretches))
    return replace(found, quarter_turns=quarter_turns(evidence.b_R_c) if turned else 0)


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
    return signed_rank_chance(evidence) < 1.0 / ODDS


def signed_rank_chance(differences: Array) -> float:
    """Return how likely differences (n,) of random signs have so large a sum of the ranks of positive ones.

    Differences of zero say nothing and are left out. Source: Wilcoxon 1945, exact.
    """
    known = differences[differences != 0]
    rank = np.argsort(np.argsort(np.abs(known))) + 1
    chance = np.ones(1)
    for k in range(1, len(known) + 1):  # the sum of the first k ranks, each with an even chance
        chance = 0.5 * (np.pad(chance, (0, k)) + np.pad(chance, (k, 0)))
    return float(chance[int(rank[known > 0].sum()) :].sum())
