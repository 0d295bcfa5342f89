"""Instruments that contradict each other, before a filter fuses them and hides it."""

from __future__ import annotations

from slam.core.clock_steps import clock_step_left, without_clock_steps
from slam.core.flight import Flight
from slam.core.imu_at_rest import gravity_reading
from slam.core.messages import Message
from slam.core.repeated_readings import repeated_readings
from slam.core.stream_anomalies import imu_axis_anomalies, velocity_anomalies
from slam.inertial.attitude_check import attitude_contradictions
from slam.inertial.drag_check import drag_contradiction
from slam.inertial.imu_motion import COMPARED, ImuMotion
from slam.inertial.instruments import InertialTrust
from slam.inertial.level_steps import level_contradictions
from slam.inertial.stream_clocks import without_stream_steps
from slam.inertial.velocity_check import velocity_contradiction


def checked(flight: Flight, trust: InertialTrust) -> tuple[Flight, list[Message]]:
    """Return the flight with its clocks set right, and each contradiction that is left, as a reason.

    Each correction is a warning of the flight. Raises ``InputError`` where the flight has too little without
    a stream that is compared.
    """
    flight = without_clock_steps(flight)
    stepped: list[Message] = []
    levels: list[Message] = []
    has_compared = any(getattr(flight, name) is not None for name in COMPARED)
    if has_compared and (motion := ImuMotion.of(flight, trust)) is not None:
        flight, motion, stepped = without_stream_steps(flight, motion, trust)
        levels = level_contradictions(flight, motion)
    changes = velocity_contradiction(flight, trust)
    # A velocity with other changes than the vehicle's has no meaning that the drag could contradict.
    drag = None if changes else drag_contradiction(flight, trust)
    if drag is not None and not drag.is_wind_excluded:
        flight = flight.with_warning(drag.line)
    gravity = None if flight.imu is None else gravity_reading(flight.imu)
    lines = [
        gravity.warning if gravity is not None and gravity.is_missing else None,
        *(imu_axis_anomalies(flight.imu) if flight.imu is not None else ()),
        changes,
        drag.line if drag is not None and drag.is_wind_excluded else None,
        clock_step_left(flight),
        *attitude_contradictions(flight),
        *stepped,
        *levels,
        *repeated_readings(flight),
        *(velocity_anomalies(flight.velocity) if flight.velocity is not None else ()),
    ]
    return flight, [line.as_reason() for line in lines if line]
