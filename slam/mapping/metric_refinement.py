"""Refinement of one part of a map with the instruments that tell its lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.problem import ScalePrior
from backend.bundle.refinement import Bundle
from backend.inertial_scale.scale import NoScale
from backend.measurements import AlignedPair, FloorTracks, InertialReadings, ReportedMotion
from slam.core.imu_at_rest import GravityReading
from slam.core.messages import Message, clauses_of, parsed, warning
from slam.core.names import enumerated
from slam.core.progress import Progress
from slam.mapping.calibration.fallback_scale import (
    WRONG_SIGN,
    falls_where_the_camera_climbs,
    scaled_by_heights,
    scaled_by_velocity,
)
from slam.mapping.calibration.inertial_scale import (
    InertialComparison,
    compare_with_inertia,
    velocity_contradicted,
)
from slam.mapping.calibration.lens import calibrated
from slam.mapping.front_end import Observations
from slam.mapping.map_part import MapPart
from slam.mapping.part_measurements import refine_part
from slam.mapping.setup import Setup


@dataclass(frozen=True)
class RefinedPart:
    """A part as it was refined, and what is to be said about its scale."""

    bundle: Bundle
    compared: InertialComparison | None
    reasons: tuple[Message, ...]
    """Why barometer and velocity do not tell the scale."""
    remarks: tuple[Message, ...] = ()
    warnings: tuple[Message, ...] = ()
    velocity_left_out: bool = False
    """Whether the accelerometer contradicts the velocity, which tells no lengths then."""


@dataclass(frozen=True)
class MetricRefinement:
    """Measurements beside those of a set-up that the refinement of each part uses."""

    observations: Observations
    tracks: FloorTracks
    inertial: InertialReadings | None
    reported: ReportedMotion | None
    progress: Progress
    aligned: tuple[AlignedPair, ...] = ()
    """Pairs of all keyframes that lines register."""
    gravity: GravityReading | None = None
    """The accelerometer's reading of gravity, where that is off."""

    def of(self, setup: Setup, part: MapPart, first: Bundle | None = None) -> RefinedPart:
        """Refine the part, with velocity and accelerometer where other sensors tell the scale less well.

        The velocity comes first, without the barometer: the accelerometer is compared with it alone. A
        velocity that the accelerometer contradicts is left out: the gains of on-board velocities are off by
        far more. Then accelerometer and barometer count beside the velocity. Without both, the barometer
        determines the scale.

        ``first``: the part as the other sensors alone refine it, where that is known already.

        Raises ``BackendError`` if the part cannot be refined.
        """
        members = part.members
        # Heights alone may tell no scale: a level flight must not fail for them.
        readings = setup.readings
        tells_lengths = readings.positions or readings.ranges or setup.control
        exact = setup if tells_lengths else setup.without_heights()
        first = first or self._refined(exact, members, part.w_T_b, part.floor_z_m)
        bundle = first
        reasons: list[Message] = []
        remarks: list[Message] = []
        if self.reported is not None and bundle.scale_std is None:
            bundle, reason = self._with_velocity(bundle, exact, members, self.reported)
            reasons += [no_scale_line("velocity0", reason)] if reason else []
        compared = self._compared(setup, members, bundle)
        lengths = _helpful(compared)
        by_velocity = self.reported if bundle.uses_reported_motion else None
        line = velocity_contradicted(compared.scale, self.gravity) if by_velocity and compared else None
        if line:
            without = replace(self, reported=None).of(setup, part, first)
            return replace(without, warnings=(line, *without.warnings), velocity_left_out=True)
        if by_velocity is not None and (lengths is not None or setup.readings.heights):
            bundle, reason = self._with_velocity(bundle, setup, members, by_velocity, lengths)
            if reason:
                others = {"the accelerometer": lengths, "the barometer": setup.readings.heights}
                names = enumerated([name for name, measured in others.items() if measured])
                failed = f"a refinement that adds {names} failed: {reason}"
                remarks.append(warning("lengths come from velocity0 alone", *clauses_of(failed)))
            if reason and compared is not None and lengths is not None:
                compared = replace(compared, scale=NoScale(reason))
        elif lengths is not None:
            bundle = self._refined(setup, members, bundle.w_T_b, bundle.floor_z_m, lengths, bundle)
        elif setup.readings.heights and bundle.scale_std is None:
            bundle, reason = scaled_by_heights(
                bundle, setup, members, self.tracks, self.aligned, self._on_step
            )
            reasons += [no_scale_line("barometer0", reason)] if reason else []
        if falls_where_the_camera_climbs(bundle.optimum.problem.measurements.heights, bundle.w_T_b):
            without = self.of(setup.without_heights(), part, None if first.uses_barometer else first)
            cause, do = WRONG_SIGN
            said = warning(f"barometer0 is left out of the map: {cause}", do).concerning("barometer0")
            return replace(without, remarks=(*without.remarks, said))
        return RefinedPart(bundle, compared, tuple(reasons), tuple(remarks))

    def _on_step(self, iteration: int, _: float) -> None:
        self.progress("refine", iteration, 0)

    def _refined(
        self,
        setup: Setup,
        members: NDArray[np.int64],
        w_T_b: NDArray[np.float64],
        floor_z_m: float,
        lengths: ScalePrior | None = None,
        before: Bundle | None = None,
    ) -> Bundle:
        """Refine ``members`` (m,) from poses ``w_T_b`` (m, 4, 4), with the noise of a bundle ``before``."""
        noise = before.noise if before is not None else None
        return refine_part(
            setup, members, w_T_b, floor_z_m, self.tracks, self._on_step, lengths, noise, self.aligned
        )

    def _with_velocity(
        self,
        bundle: Bundle,
        setup: Setup,
        members: NDArray[np.int64],
        reported: ReportedMotion,
        lengths: ScalePrior | None = None,
    ) -> tuple[Bundle, str]:
        return scaled_by_velocity(
            bundle,
            setup,
            members,
            self.tracks,
            self.observations,
            reported,
            self.aligned,
            self._on_step,
            lengths,
        )

    def _compared(
        self, setup: Setup, members: NDArray[np.int64], bundle: Bundle
    ) -> InertialComparison | None:
        if self.inertial is None:
            return None
        camera, gain_std = calibrated(setup.camera, bundle), setup.config.trust.accel_gain_std
        return compare_with_inertia(
            self.inertial, self.observations, members, bundle, camera, gain_std, self.gravity
        )


def no_scale_line(instrument: str, reason: str) -> Message:
    """Return the line about an ``instrument`` that does not tell lengths in metres.

    ``reason``: the text of `backend` or of `slam.mapping.calibration.fallback_scale`.
    """
    return parsed(f"{instrument} could not determine the metric scale: {reason}")


def _helpful(compared: InertialComparison | None) -> ScalePrior | None:
    """Return lengths by the accelerometer that make those of the map better known."""
    if compared is None or isinstance(compared.scale, NoScale) or not compared.scale.helps:
        return None
    return compared.scale.lengths
