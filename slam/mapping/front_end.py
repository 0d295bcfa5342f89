"""From pictures to registrations: track, gate, keyframe, close_loops, verify."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.features import Extractor, Features
from frontend.keyframes import IsUrged, Tracker
from frontend.loops import overlapping, propose_loops, verify
from frontend.motions import DISTINCT_MOTION_WIDTHS, Expectation, OtherMotion
from frontend.opencv_features import FeatureUnavailableError
from frontend.registration import Registration, overlap, refused, register
from frontend.store import FeatureStore
from frontend.tracked import IntermediateFrame
from frontend.views import Masks
from slam.core.checkpoints import NO_CHECKPOINTS, Checkpoints
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import Progress
from slam.mapping.checkpoints.photographs import PhotographCheckpoints
from slam.mapping.checkpoints.registrations import RegistrationCheckpoints
from slam.mapping.checkpoints.tracking import TrackingCheckpoints
from slam.mapping.config import PipelineConfig
from slam.mapping.contradicted_step import ContradictedStep
from slam.mapping.earlier_pass import EarlierPass, comparison_key
from slam.mapping.floor_views import FloorViews
from slam.mapping.floor_visibility import horizon_masks, joined
from slam.mapping.obstacles import no_masks
from slam.mapping.read_ahead import read_ahead
from slam.mapping.search_radius import SearchRadius
from slam.mapping.tracked_pictures import TrackedPictures

Array = NDArray[np.float64]

LINK = 2
"""A link stands on the pictures between its ends too: it counts for as many pairs that agree with it."""


@dataclass(frozen=True)
class Observations:
    """Results of the front end for one flight."""

    store: FeatureStore
    frame_index: NDArray[np.int64]
    """(n,) frame of each keyframe."""
    stamps_s: Array
    """(n,)."""
    links: tuple[Registration | None, ...]
    """(n,) registration of each keyframe to the one before; None where tracking started anew."""
    registrations: tuple[Registration, ...]
    """All that hold, links included."""
    refused: tuple[Registration, ...]
    """Candidates that did not verify, and the ``contradicted`` ones."""
    frames: int
    rejected: Counter[str]
    moving: Mapping[int, OtherMotion] = field(default_factory=dict)
    """Frames in which something moves otherwise than the floor."""
    frame_stamps_s: Array = field(default_factory=lambda: np.empty(0))
    """(f,) of all frames, on the clock of the instruments as far as it is known."""
    camera_stamps_s: Array = field(default_factory=lambda: np.empty(0))
    """(f,) of all frames, on the camera's clock."""
    passed: tuple[IntermediateFrame, ...] = ()
    """Frames between keyframes."""
    dropped: dict[int, str] = field(default_factory=dict)
    """Number of each frame that was not used -> reason."""
    contradicted: frozenset[tuple[int, int]] = frozenset()
    """Pairs (i, j) that verified, but that known poses or other pictures contradict."""
    by_instruments: bool = False
    """Whether instruments told tracking where to expect the floor."""
    corner_speed: Array = field(default_factory=lambda: np.empty((0, 4, 2)))
    """(n, 4, 2) speed of the floor in the corners of a video's keyframes, focal lengths/s; NaN if unknown."""
    contradicted_steps: tuple[ContradictedStep, ...] = ()
    """Steps of odometry that pairs of pictures contradict by one displacement."""

    def registered(self) -> list[list[IntermediateFrame]]:
        """Return, for each keyframe, the frames registered to it in tracking, in order.

        The keyframe itself comes first, without an error. The next keyframe is among them, if it is linked;
        in flight, pictures may follow it that waited for its features.
        """
        seen = [
            [IntermediateFrame(int(frame), k, np.eye(3), np.zeros((8, 8)))]
            for k, frame in enumerate(self.frame_index)
        ]
        for passed in self.passed:
            seen[passed.keyframe].append(passed)
        for link in self.links:
            if link is not None:
                frame = int(self.frame_index[link.j])
                seen[link.i].append(IntermediateFrame(frame, link.i, link.i_H_j, link.corner_covariance))
        return [sorted(frames, key=lambda row: row.frame) for frames in seen]

    def stamped_by(self, delays_at: Callable[[Array], Array]) -> Observations:
        """Return the same with the cameras' stamps less the delay (n,) that a function gives for them."""
        stamps_s = self.camera_stamps_s - delays_at(self.camera_stamps_s)
        return replace(self, stamps_s=stamps_s[self.frame_index], frame_stamps_s=stamps_s)

    def without(self, reasons: Mapping[tuple[int, int], Rejection]) -> Observations:
        """The same with some pairs (i, j) refused, each for its reason."""
        taken = tuple(
            replace(r, reason=reasons[r.i, r.j]) for r in self.registrations if (r.i, r.j) in reasons
        )
        kept = tuple(r for r in self.registrations if (r.i, r.j) not in reasons)
        contradicted = self.contradicted | {(r.i, r.j) for r in taken}
        return replace(self, registrations=kept, refused=(*self.refused, *taken), contradicted=contradicted)


def extractor_of(config: PipelineConfig, camera: Camera) -> Extractor:
    """Return what finds the features. Raises ``InputError`` where OpenCV lacks the configured ones."""
    try:
        return Extractor(config.features.for_width(camera.size_px[0]))
    except FeatureUnavailableError as error:
        raise InputError(str(error)) from None


class FrontEnd:
    """The front end with its settings for one flight."""

    def __init__(
        self,
        flight: Flight,
        camera: Camera,
        config: PipelineConfig,
        progress: Progress,
        earlier: EarlierPass | None = None,
        masks: Masks = no_masks,
        checkpoints: Checkpoints = NO_CHECKPOINTS,
    ) -> None:
        """``earlier``: work on the same pictures without masks. ``masks``: pixels that are not used, beside
        those near the horizon by the attitude (`slam.mapping.floor_visibility`). ``checkpoints``: work of an
        earlier run."""
        width = camera.size_px[0]
        self.flight, self.camera, self.config, self.progress = flight, camera, config, progress
        self.earlier, self.work = earlier or EarlierPass(), EarlierPass()
        self.is_masked, self.by_instruments = masks is not no_masks, False
        self.views = FloorViews(flight, camera, config)
        self.masks = joined(masks, horizon_masks(flight, camera))
        self.homography = config.homography.for_width(width)
        self.extractor = extractor_of(config, camera)
        self.checkpoints = checkpoints
        self.compared = RegistrationCheckpoints(checkpoints, camera, self.homography, config.gates)
        """Comparisons of an earlier run."""
        self.tracked: TrackedPictures | None = None  # the result of the last pass over the frames

    def tracker(self, look_ahead: bool = True, is_urged: IsUrged = lambda features: False) -> Tracker:
        """Return the tracker of one pass over the frames; ``look_ahead`` and ``is_urged`` as there."""
        return Tracker(
            self.camera, self.extractor, self.homography, self.config.gates, self.config.keyframes,
            self.masks, self.earlier.features, look_ahead, is_urged,
            self.views if look_ahead else None, self.by_instruments,
        )  # fmt: skip

    def track_by_instruments(self) -> Observations:
        """Go through the frames once more, and expect the floor where the instruments have it."""
        self.by_instruments, self.earlier = True, self.work
        return self.track()

    def track(self) -> Observations:
        """Go through the frames once: mask, track, gate, keyframe."""
        if self.flight.all_keyframes:
            tracked = TrackedPictures(self.tracker())
            self._search(tracked)
            return self.observations(tracked)
        is_first = not (self.is_masked or self.by_instruments) and self.earlier.store is None
        used = self.checkpoints if is_first else NO_CHECKPOINTS
        checkpoints = TrackingCheckpoints(used, self.flight, (self.camera, self.config))
        tracked, start = checkpoints.resume(lambda: TrackedPictures(self.tracker()))
        if start is not None:  # not all is tracked
            images = read_ahead(self.flight, self.progress, start.frame)
            for keyframe in tracked.tracker.keyframes(images, start, partial(checkpoints.offer, tracked)):
                tracked.add(keyframe)
            checkpoints.end(tracked)
        return self.observations(tracked)

    def _search(self, tracked: TrackedPictures) -> None:
        """Add every photograph as a keyframe."""
        frames = self.flight.frames
        assert frames is not None
        config = self.extractor.config
        checkpoints = PhotographCheckpoints(self.checkpoints, frames, self.camera, config, self.compared)
        for keyframe in tracked.tracker.every(frames.load, len(frames), checkpoints):
            self.progress("track", keyframe.frame + 1, len(frames))
            tracked.add(keyframe)
        self.progress("track", len(frames), len(frames))
        checkpoints.tell()

    def observations(self, tracked: TrackedPictures) -> Observations:
        """Return what tracking found."""
        flight, tracker, self.tracked = self.flight, tracked.tracker, tracked
        assert flight.frames is not None
        read = tracked.unreadable | dict(flight.frames.failures)
        unreadable = {k: f"unreadable: {reason}" for k, reason in read.items()}
        failures = unreadable | tracked.failures
        index = np.array(tracked.frame_index, dtype=np.int64)
        if not self.is_masked:
            # Features on moving objects were removed.
            whole = {frame: k for k, frame in enumerate(tracked.frame_index) if frame not in tracker.moving}
            self.work = EarlierPass(tracked.store, whole)
        # A picture is that of its middle row.
        frame_stamps_s = flight.frames.stamps_s + 0.5 * self.camera.readout_s
        return Observations(
            store=tracked.store,
            frame_index=index,
            stamps_s=frame_stamps_s[index] if len(index) else np.empty(0),
            links=tuple(tracked.links),
            registrations=tuple(link for link in tracked.links if link is not None),
            refused=tuple(tracked.refused),
            frames=tracker.frames,
            rejected=_with_reasons(tracker.rejected, failures),
            moving=dict(tracker.moving),
            by_instruments=self.by_instruments,
            frame_stamps_s=frame_stamps_s,
            camera_stamps_s=frame_stamps_s,
            passed=tuple(tracker.passed),
            dropped=tracker.dropped | failures,
        )

    def register(
        self, i: int, j: int, a: Features, b: Features, expected: Expectation | None
    ) -> Registration:
        """Keyframe j registered to i, where the floor is expected."""
        return register(i, j, a, b, self.camera, self.homography, self.config.gates, expected)

    def neighbours(self, observations: Observations) -> Observations:
        """Compare each keyframe with the ones just before the last: a chain alone is weak."""
        composed: dict[tuple[int, int], Array] = {}
        for k in range(2, len(observations.links)):
            i_H_k, i = np.eye(3), k
            while i > 0 and k - i < 4 and (link := observations.links[i]) is not None:
                i_H_k, i = link.i_H_j @ i_H_k, i - 1
                if k - i > 1 and overlap(i_H_k, self.camera) >= self.config.loops.min_overlap:
                    composed[i, k] = i_H_k
        compared = self._compare(observations, list(composed), "neighbours", lambda i, j: composed[i, j])
        return compared.without(self._against_chain(compared, composed))

    def _against_chain(
        self, observations: Observations, composed: Mapping[tuple[int, int], Array]
    ) -> dict[tuple[int, int], Rejection]:
        """Neighbours that lie elsewhere than the links between them have it: (i, j) -> reason.

        They matched a look-alike beside their common floor, unless most that cross a link contradict it.
        """
        corners_px, width_px = self.camera.undistort(self.camera.corners_px), self.camera.size_px[0]
        off: dict[tuple[int, int], float] = {}
        for r in observations.registrations:
            by_chain = Expectation.at(composed[r.i, r.j], corners_px) if (r.i, r.j) in composed else None
            if by_chain is not None:
                off[r.i, r.j] = by_chain.off_px(r.i_H_j, corners_px) / width_px
        agree = np.full(len(observations.links), LINK)
        for (i, j), widths in off.items():
            agree[i + 1 : j + 1] += 1 if widths <= DISTINCT_MOTION_WIDTHS else -1
        return {
            (i, j): Rejection(LinkCheck.CHAIN, f"{widths:.2f} picture widths off")
            for (i, j), widths in off.items()
            if widths > DISTINCT_MOTION_WIDTHS and (agree[i + 1 : j + 1] > 0).all()
        }

    def close_loops(self, observations: Observations, reach: SearchRadius) -> Observations:
        """Compare keyframes that look alike, were not compared yet, and lie within reach of each other."""
        retrieval, loops = self.config.retrieval, self.config.loops
        each = loops.neighbours(retrieval.neighbours, len(observations.store))
        retrieval = replace(retrieval, neighbours=each)
        met: dict[int, list[int]] = {}
        for r in (*observations.registrations, *observations.refused):
            met.setdefault(r.i, []).append(r.j)
            met.setdefault(r.j, []).append(r.i)

        def gate(j: int, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
            return reach.holds(j, rows) & ~np.isin(rows, met.get(j, []))

        found = propose_loops(observations.store, retrieval, gate)
        known = {(r.i, r.j) for r in (*observations.registrations, *observations.refused)}
        beyond = tuple(refused(i, j, reach.reason(i, j)) for i, j in found.gated if (i, j) not in known)
        return self._compare(
            replace(observations, refused=(*observations.refused, *beyond)), found.pairs, "loops"
        )

    def match_overlaps(
        self,
        observations: Observations,
        w_T_b: Array,
        floor_z_m: float,
        world: NDArray[np.int64] | None = None,
    ) -> Observations:
        """Compare keyframes that the poses say overlap; ``world`` as in `frontend.loops.overlapping`."""
        loops = self.config.loops
        neighbours = loops.overlapping(len(w_T_b))
        pairs = overlapping(self.camera, w_T_b, floor_z_m, loops.min_overlap, neighbours, world)

        def known(i: int, j: int) -> Array:
            floor_H_i, floor_H_j = (self.camera.floor_H_image(w_T_b[k], floor_z_m) for k in (i, j))
            return np.asarray(np.linalg.inv(floor_H_i) @ floor_H_j, dtype=float)

        return self._compare(observations, pairs, "overlaps", known)

    def _compare(
        self,
        observations: Observations,
        pairs: Sequence[tuple[int, int]],
        stage: str,
        i_H_j: Callable[[int, int], Array] | None = None,
    ) -> Observations:
        """``i_H_j``: where the pictures of a pair are known to lie, unless the floor repeats there."""
        corners_px = self.camera.undistort(self.camera.corners_px)

        def expected(i: int, j: int) -> Expectation | None:
            return None if i_H_j is None else Expectation.at(i_H_j(i, j), corners_px)

        known = {(r.i, r.j) for r in (*observations.registrations, *observations.refused)}
        pairs = [pair for pair in dict.fromkeys(pairs) if pair not in known]
        accepted, refused = list(observations.registrations), list(observations.refused)
        keys = {(i, j): comparison_key(observations.store, i, j, expected(i, j)) for i, j in pairs}
        found = self.earlier.compared(keys)
        found |= self.compared.recall({p: key for p, key in keys.items() if p not in found}, len(pairs))
        new = {pair: key for pair, key in keys.items() if pair not in found}
        verdicts = verify(
            list(new),
            observations.store,
            self.camera,
            self.homography,
            self.config.gates,
            on_done=lambda done: self.progress(stage, done, len(new)),
            expected=expected,
        )
        for r in verdicts:
            found[r.i, r.j] = r
            self.compared.keep(r, new[r.i, r.j])
        for pair, key in keys.items():
            self.work.registrations[key] = found[pair]
            (accepted if found[pair].ok else refused).append(found[pair])
        return replace(observations, registrations=tuple(accepted), refused=tuple(refused))


def _with_reasons(rejected: Counter[str], failures: Mapping[int, str]) -> Counter[str]:
    """The counts with what kept pictures from being read, where their loader knows it."""
    known = Counter(failures.values())
    return rejected - Counter(unreadable=known.total()) + known
