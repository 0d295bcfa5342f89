"""`LiveMapper`: a map that grows with every picture, and the post-flight map after the last one."""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from frontend.features import Features
from frontend.tracked import Keyframe
from slam.core.arguments import check_flight
from slam.core.errors import NO_CAMERA, InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.core.streams import Image, Imu
from slam.mapping.config import PipelineConfig
from slam.mapping.floor_visibility import without_horizon_frames
from slam.mapping.front_end import FrontEnd
from slam.mapping.inertial.measurements import stated_inertial
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.live.graph import LiveGraph, LiveLink
from slam.mapping.live.loops import LiveLoops
from slam.mapping.live.recording import LiveRecording
from slam.mapping.live.rehearsal import rehearse
from slam.mapping.live.worker import Worker
from slam.mapping.pipeline import optimize_with_observations
from slam.mapping.tracked_pictures import TrackedPictures

Array = NDArray[np.float64]

LATE = "late: it arrived while earlier pictures were processed; send fewer, or smaller ones (--width)"
"""Reason for which a picture is dropped."""
MOST_WAIT_S = 0.1
"""Time that a picture may wait while a later one waits too. It absorbs the time of a keyframe's features, and
with the tracking itself leaves each pose younger than the 150 ms that control in flight can use."""


@dataclass(frozen=True)
class _Arrived:
    """A picture that waits to be tracked."""

    number: int
    image: Image
    at_s: float
    """Time at which it arrived, on the clock of `time.perf_counter`."""
    in_flight: bool
    """Whether the camera goes on while it waits."""


@dataclass(frozen=True)
class LiveState:
    """State of a live map at one moment."""

    pictures: int
    """Pictures that were given, the dropped ones included."""
    dropped: int
    """Pictures that came too soon after others to be tracked."""
    keyframes: int
    """Keyframes in the graph."""
    waiting: int
    """Keyframes whose loops are still searched."""
    placed: int
    """Keyframes that are joined to the first."""
    loops: int
    rejected: int
    """Edges of the pose graph that are rejected at present."""
    bridged: int
    """Keyframes behind gaps between pictures, which readings of the IMU join to the one before."""
    stamp_s: float
    """Time of the newest picture that is placed; NaN before the first."""
    w_T_b: Array | None
    """(4, 4) pose of that picture over the floor at 0; None before the first."""
    latency_s: Array
    """(m,) time from the arrival of each tracked picture until it was tracked."""


class LiveMapper:
    """Track pictures as they arrive, in threads of its own, so that `add` returns at once.

    One thread tracks. The other one searches the loops of each keyframe and solves the graph, so that a
    picture waits for neither. A picture that has waited for longer than ``MOST_WAIT_S`` when its turn comes
    is dropped and counted, unless it is the newest. The poses are relative to the first keyframe, over the
    floor at z = 0, in metres where ranges are known. GPS and obstacles enter in `finish`.
    """

    def __init__(self, flight: Flight, config: PipelineConfig = PipelineConfig()) -> None:
        """``flight`` has the camera. Streams that it has are read at the times of the pictures; the readings
        that are given to `add` stand in for streams that it lacks. Raises ``InputError`` without a camera."""
        check_flight(flight)
        if flight.camera is None:
            raise InputError(f"{flight.name}: no camera in this flight, so no live map; {NO_CAMERA}")
        self._config, self._camera = config, flight.camera
        self._recording = LiveRecording(flight)
        front_end = FrontEnd(flight, flight.camera, config, silent)
        rehearse(front_end)
        self._tracked = TrackedPictures(front_end.tracker(look_ahead=False, is_urged=self._is_urged))
        self._loops = LiveLoops(self._tracked.store, front_end)
        self._graph, self._graph_lock = LiveGraph(flight.camera, config), threading.Lock()
        self._latency_s: list[float] = []
        self._arrival = threading.Condition()
        self._waiting: deque[_Arrived] = deque()
        self._ended = False
        self._errors: list[BaseException] = []
        self._mapping = Worker("live map", self._note_error)
        self._tracking = Worker("live tracking", self._note_error)
        self._tracking.submit(self._track)
        atexit.register(self._abandon)

    def add(
        self,
        image: Image | None,
        stamp_s: float,
        roll_pitch_yaw_rad: Array | None = None,
        range_m: float | None = None,
        wait: bool = False,
        imu: Imu | None = None,
    ) -> None:
        """Take the next picture (h, w) or (h, w, 3), with the attitude (3,) and slant range at its time.

        None stands for a picture that cannot be read. ``wait`` waits until tracking of the picture before
        begins, so that none is dropped. ``imu`` has the readings since the picture before: those that cover
        the time between two keyframes join them where no picture does.

        Raises ``InputError`` where the stamps do not increase and for readings of another shape, and whatever
        the threads raised.
        """
        number = self._recording.add(stamp_s, roll_pitch_yaw_rad, range_m, imu)
        with self._arrival:
            while wait and self._waiting and not self._errors:
                self._arrival.wait()
            self._raise_errors()
            if image is None:
                return
            self._waiting.append(_Arrived(number, image.copy(), time.perf_counter(), in_flight=not wait))
            self._drop_late()
            self._arrival.notify_all()

    def skip(self, stamp_s: float) -> None:
        """Count the next picture as dropped: there was no time to read it. Raises as `add` does."""
        number = self._recording.add(stamp_s)
        self._raise_errors()
        self._tracked.failures[number] = LATE

    def refresh(self, flight: Flight) -> None:
        """Read the instruments from another state of the flight, whose streams have grown since."""
        self._recording.refresh(flight)

    def state(self) -> LiveState:
        """Return what is known now."""
        with self._graph_lock:
            poses, loops, rejected = self._graph.poses(), self._graph.loops, self._graph.rejected
            bridged = self._graph.bridged
            newest = self._tracked.tracker.newest
            pose = None if newest is None else self._graph.frame_pose(newest)
        placed = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
        frame = newest.frame if newest is not None else -1
        if pose is None and len(placed):
            frame, pose = self._tracked.frame_index[placed[-1]], poses[placed[-1]]
        return LiveState(
            pictures=len(self._recording),
            dropped=len(self._tracked.failures),
            keyframes=len(poses),
            waiting=len(self._tracked.frame_index) - len(poses),
            placed=len(placed),
            loops=loops,
            rejected=rejected,
            bridged=bridged,
            stamp_s=np.nan if pose is None else self._recording.stamp_s(frame),
            w_T_b=pose,
            latency_s=np.array(self._latency_s),
        )

    def keyframes(self) -> tuple[NDArray[np.int64], Array]:
        """Return the frame numbers (n,) and the current poses (n, 4, 4) of the keyframes; NaN where not
        placed."""
        with self._graph_lock:
            poses = self._graph.poses()
        return np.array(self._tracked.frame_index[: len(poses)], dtype=np.int64), poses

    def links(self) -> tuple[LiveLink, ...]:
        """Return the edges between keyframes, those included that are rejected at present."""
        with self._graph_lock:
            return self._graph.links()

    def picture(self, frame: int) -> Image | None:
        """Return the picture of a keyframe by its frame number; None for another frame."""
        return self._recording.picture(frame)

    def flight(self) -> Flight:
        """Return the flight so far, for example for `slam.report.rasters.mosaic.write_mosaic`.

        If it was given without pictures, it has those of the keyframes, as long as this mapper exists.
        """
        return self._recording.flight()

    def finish(self, progress: Progress = silent) -> Estimate:
        """End the flight and return the post-flight map of the pictures that were tracked.

        Raises ``InputError`` as `slam.optimize` does, and what the threads raised.
        """
        self.close()
        self._raise_errors()
        return optimize_with_observations(self.flight(), self._config, progress, self._tracked)[0]

    def close(self) -> None:
        """End the flight: wait until the last picture is in the map."""
        with self._arrival:
            self._ended = True
            self._arrival.notify_all()
        self._tracking.close()
        self._mapping.close()
        atexit.unregister(self._abandon)

    def _abandon(self) -> None:
        """End the threads of a program that ends without `close`; what waits to be tracked or mapped is left
        out."""
        self._mapping.drop()
        with self._arrival:
            self._waiting.clear()
        self.close()

    def __enter__(self) -> LiveMapper:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._recording.close()

    def _raise_errors(self) -> None:
        if self._errors:
            raise self._errors[0]

    def _note_error(self, error: BaseException) -> None:
        """Keep the error of a thread for the caller's, and let that one wait no longer."""
        with self._arrival:
            self._errors.append(error)
            self._arrival.notify_all()

    def _track(self) -> None:
        for keyframe in self._tracked.tracker.keyframes(self._images()):
            self._tracked.add(keyframe)
            self._mapping.submit(partial(self._map, keyframe))

    def _images(self) -> Iterator[Image | None]:
        """Yield every picture, None for those that were dropped; wait for the next one."""
        done = 0
        while (arrived := self._next()) is not None:
            yield from [None] * (arrived.number - done)
            yield arrived.image
            done = arrived.number + 1
            self._latency_s.append(time.perf_counter() - arrived.at_s)
        yield from [None] * (len(self._recording) - done)

    def _is_urged(self, features: Future[Features]) -> bool:
        """Wait for the features of a keyframe; return whether a picture waits before they are there."""
        features.add_done_callback(self._notify)
        with self._arrival:
            while not (features.done() or self._ended or self._is_in_flight()):
                self._arrival.wait()
            return not features.done() and self._is_in_flight()

    def _is_in_flight(self) -> bool:
        return any(arrived.in_flight for arrived in self._waiting)

    def _notify(self, _: Future[Features]) -> None:
        with self._arrival:
            self._arrival.notify_all()

    def _next(self) -> _Arrived | None:
        """Return the picture that waits, or the next one that arrives; None at the end of the flight."""
        with self._arrival:
            while not self._waiting and not self._ended:
                self._arrival.wait()
            self._drop_late()
            arrived = self._waiting.popleft() if self._waiting else None
            self._arrival.notify_all()
            return arrived

    def _drop_late(self) -> None:
        """Drop pictures that have waited too long; the newest one stays."""
        while len(self._waiting) > 1 and time.perf_counter() - self._waiting[0].at_s > MOST_WAIT_S:
            self._tracked.failures[self._waiting.popleft().number] = LATE

    def _map(self, keyframe: Keyframe) -> None:
        """Add a keyframe to the graph with its registrations."""
        stamp_s = self._recording.stamp_s(keyframe.frame) + 0.5 * self._camera.readout_s
        recent = without_horizon_frames(self._recording.recent(), self._camera)
        readings = KeyframeReadings.at(recent, np.array([stamp_s]), None, self._config)
        self._recording.keep(keyframe)
        imu = self._recording.imu(self._graph.newest_s, stamp_s)
        inertial = stated_inertial(imu, self._config)
        found = self._loops.of_newest(keyframe, stamp_s, self._graph.poses())
        try:
            with self._graph_lock:
                self._graph.add(readings, found, inertial)
        except BackendError as error:
            raise InputError(f"{self._recording.name}: the live map ends here: {error}") from error
