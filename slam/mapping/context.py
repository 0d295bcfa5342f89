"""Inputs and tools of one map that stay the same from odometry to the final refinement."""

from __future__ import annotations

from dataclasses import dataclass, replace

from backend.clocks.picture_clock import PictureClock
from frontend.camera import Camera
from slam.core.checkpoints import NO_CHECKPOINTS, Checkpoints
from slam.core.flight import Flight
from slam.core.messages import Message
from slam.core.progress import Progress
from slam.core.stage_timer import Stopwatch
from slam.mapping.calibration.clock_offset import NO_CORRECTION
from slam.mapping.calibration.refuted import Refuted
from slam.mapping.calibration.rolling_shutter import frames_exposure
from slam.mapping.config import PipelineConfig
from slam.mapping.control_points import surveyed_in_world
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.inertial.bridges import InertialBridges
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.setup import Setup


@dataclass(frozen=True)
class Job:
    """Camera and settings of a flight, and what reports progress and time."""

    camera: Camera
    config: PipelineConfig
    progress: Progress
    timer: Stopwatch
    checkpoints: Checkpoints = NO_CHECKPOINTS
    """Work of an earlier run, and where that of this one is kept."""


@dataclass(frozen=True)
class Context:
    """The flight with its keyframes, as the stages of the back end need it."""

    flight: Flight
    job: Job
    front_end: FrontEnd
    setup: Setup
    bridges: InertialBridges
    clock: PictureClock = NO_CORRECTION
    """Delays that were taken out of the pictures' stamps."""
    tracked: Observations | None = None
    """Result of tracking, before keyframes were compared further."""
    refuted: tuple[Refuted, ...] = ()
    """Calibrations that were fixed in an earlier map and that the pictures refuted: they are free parameters
    of this one."""
    still_fixed: tuple[Refuted, ...] = ()
    """Calibrations that this map refutes, and that are fixed as no map came out with them free."""
    reason_still_fixed: Message | None = None
    """Why a refuted antenna's place is fixed all the same; None where none is."""
    doubted_lens: Message | None = None
    """Warning about a lens that is refuted and fixed all the same; None where none is."""

    @staticmethod
    def of(flight: Flight, job: Job, front_end: FrontEnd, observations: Observations) -> Context:
        """Read the instruments at the keyframes."""
        return Context(flight, job, front_end, *_at_keyframes(flight, job, observations))

    @property
    def timer(self) -> Stopwatch:
        """Timer of the stages."""
        return self.job.timer

    def calibrated(self, clock: PictureClock, camera: Camera, observations: Observations) -> Context:
        """Return the context for another camera, and for pictures without the delays of ``clock``."""
        job = replace(self.job, camera=camera)
        setup, bridges = _at_keyframes(self.flight, job, observations)
        return replace(self, job=job, setup=setup, bridges=bridges, clock=clock)

    def with_flight(self, flight: Flight, observations: Observations) -> Context:
        """Return the context for other readings of the instruments, or for other accuracies of them."""
        return replace(self, flight=flight).calibrated(self.clock, self.job.camera, observations)

    @property
    def refuted_lens(self) -> Refuted | None:
        """The declared lens, where this map has an estimated one instead."""
        return next((refuted for refuted in self.refuted if refuted.what == "lens"), None)

    def with_warning(self, line: Message) -> Context:
        """Return the context with one more warning for the user."""
        return replace(self, flight=self.flight.with_warning(line))

    def on_step(self, iteration: int, _: float) -> None:
        """Report an iteration of the pose graph."""
        self.job.progress("graph", iteration, 0)


def _at_keyframes(flight: Flight, job: Job, observations: Observations) -> tuple[Setup, InertialBridges]:
    """Read the instruments at the keyframes."""
    origin = flight.geo_origin()
    readings = KeyframeReadings.at(flight, observations.stamps_s, origin, job.config)
    if not flight.all_keyframes:
        readings = replace(readings, exposure=frames_exposure(observations, job.camera))
    surveyed = surveyed_in_world(flight, origin, observations.frame_index)
    setup = Setup(job.camera, readings, job.config, surveyed)
    bridges = InertialBridges(flight, setup, observations.links, job.config.inertial, job.progress)
    return setup, bridges
