"""Correction of a flight by a model of its instruments, so that the map profits from criticism.

Each term that changes readings is inverted, in the reverse order of `slam.simulation`. Terms of the vehicle
and of the place stay. So do the individual differences of healthy instruments, such as the sonar's zero: the
map estimates them itself. Where the model has a standard deviation of a term, it replaces the manufacturer's
figure for the back end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from slam.core.flight import Flight
from slam.simulation.inverse import camera, clocks, flow, inertial, sonar
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

CHANGES_READINGS = ("sensor", "image", "clock")
"""Values of ``acts_on`` of terms that change readings; others change the motion or the place."""

INVERSES: dict[str, tuple[str, Callable[[Flight, Model], Flight]]] = {
    "clock_drift": ("", clocks.clock_drift),
    "camera_time_offset": ("frames", clocks.camera_time_offset),
    "focal_length": ("camera", camera.focal_length),
    "radial_distortion": ("camera", camera.radial_distortion),
    "camera_tilt": ("camera", camera.camera_tilt),
    "rolling_shutter": ("camera", camera.rolling_shutter),
    "vignetting": ("frames", camera.vignetting),
    "gyro_bias": ("imu", inertial.gyro_bias),
    "gyro_scale": ("imu", inertial.gyro_scale),
    "accel_bias": ("imu", inertial.accel_bias),
    "accel_scale": ("imu", inertial.accel_scale),
    "imu_misalignment": ("imu", inertial.imu_misalignment),
    "sonar_dead_zone": ("sonar", sonar.sonar_dead_zone),
    "sonar_quantisation": ("sonar", sonar.sonar_quantisation),
    "sonar_bias": ("sonar", sonar.sonar_bias),
    "sonar_scale": ("sonar", sonar.sonar_scale),
    "sonar_temperature": ("sonar", sonar.sonar_temperature),
    "sonar_slant": ("sonar", sonar.sonar_slant),
    "sonar_tilt": ("sonar", sonar.sonar_tilt),
    "sonar_lag": ("sonar", clocks.sonar_lag),
    "flow_scale": ("velocity", flow.flow_scale),
    "flow_derotation": ("velocity", flow.flow_derotation),
}
"""Term -> the stream that it changes and its inverse, in the order of correction."""


@dataclass(frozen=True)
class CorrectedFlight:
    """A corrected flight, and the terms that were and were not corrected."""

    flight: Flight
    corrected_terms: tuple[str, ...]
    """Terms with their values, as text."""
    uncorrected: tuple[str, ...]
    """Names of terms without an inverse: their effect is a loss or random."""

    def summary(self, model: Model) -> str:
        """Return one line about the corrected and the uncorrected terms."""
        done = ", ".join(self.corrected_terms) or "nothing that changes a reading of this flight"
        rest = f"; left as it is: {', '.join(self.uncorrected)}" if self.uncorrected else ""
        return f"model {model.name!r} taken out of the readings: {done}{rest}"


def correct_flight(flight: Flight, model: Model) -> CorrectedFlight:
    """Return the flight as healthy instruments would have recorded it, according to the model."""
    corrected_terms = []
    for name, (stream, undo) in INVERSES.items():
        if model.holds(name) and (not stream or getattr(flight, stream) is not None):
            flight = undo(flight, model)
            corrected_terms.append(f"{name} ({_values(model, name)})")
    uncorrected = tuple(
        n for n in model.terms if changes_readings(n) and n not in INVERSES and model.holds(n)
    )
    return CorrectedFlight(flight, tuple(corrected_terms), uncorrected)


def changes_readings(term: str) -> bool:
    """Whether a term of the catalogue belongs to the instruments, not to the vehicle or the place."""
    return CATALOGUE[term].acts_on in CHANGES_READINGS


def _values(model: Model, name: str) -> str:
    return ", ".join(
        f"{p.name} {model.value(name, p.name):.3g}{'' if p.unit == '1' else f' {p.unit}'}"
        for p in CATALOGUE[name].parameters
        if model.value(name, p.name) != p.neutral
    )
