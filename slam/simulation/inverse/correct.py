"""A flight without what a model says of its instruments: how findings of criticism come into the map.

Each term that changes readings is undone as `slam.simulation` does it, the last that was done first. Terms
of the vehicle and of the place are none of the instruments' and stay, and so does what healthy instruments
differ by, as the sonar's zero: the map estimates that itself. Where the model tells how surely it
knows a term, the back end is told so in place of what the maker claims.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from slam.core.flight import Flight
from slam.simulation.inverse import camera, clocks, flow, inertial, sonar
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

CHANGES_READINGS = ("sensor", "image", "clock")
"""What such terms act on; others change how the vehicle moves, or where."""

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
"""Term -> the stream without which it changes nothing, and how it is undone; in the order of undoing."""


@dataclass(frozen=True)
class CorrectedFlight:
    """A flight, and what became of each term of the model that changes readings."""

    flight: Flight
    corrected_terms: tuple[str, ...]
    """Terms with their sizes, in words."""
    uncorrected: tuple[str, ...]
    """Names of terms that readings cannot be freed of: what is lost, or random."""

    def summary(self, model: Model) -> str:
        """One line."""
        done = ", ".join(self.corrected_terms) or "nothing that changes a reading of this flight"
        rest = f"; left as it is: {', '.join(self.uncorrected)}" if self.uncorrected else ""
        return f"model {model.name!r} taken out of the readings: {done}{rest}"


def correct_flight(flight: Flight, model: Model) -> CorrectedFlight:
    """The flight as healthy instruments would have recorded it, as far as the model knows theirs."""
    corrected_terms = []
    for name, (stream, undo) in INVERSES.items():
        if model.holds(name) and (not stream or getattr(flight, stream) is not None):
            flight = undo(flight, model)
            corrected_terms.append(f"{name} ({_sizes(model, name)})")
    uncorrected = tuple(
        n for n in model.terms if changes_readings(n) and n not in INVERSES and model.holds(n)
    )
    return CorrectedFlight(flight, tuple(corrected_terms), uncorrected)


def changes_readings(term: str) -> bool:
    """Whether a term of the catalogue is one of the instruments', not of the vehicle or the place."""
    return CATALOGUE[term].acts_on in CHANGES_READINGS


def _sizes(model: Model, name: str) -> str:
    return ", ".join(
        f"{p.name} {model.value(name, p.name):.3g}{'' if p.unit == '1' else f' {p.unit}'}"
        for p in CATALOGUE[name].parameters
        if model.value(name, p.name) != p.neutral
    )
