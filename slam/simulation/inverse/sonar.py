"""Corrections of the sonar: ranges of a pencil beam with exact scale and zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight, Sonar
from slam.core.rotations import up_at
from slam.simulation.model import Model
from slam.simulation.sensors import ASSUMED_DEG_C, SOUND_M_S, SOUND_M_S_K


def sonar_dead_zone(flight: Flight, model: Model) -> Flight:
    """Remove ranges at the limit of the dead zone, within the noise; the true range may be any below."""
    sonar = _sonar(flight)
    stuck = sonar.range_m <= model.value("sonar_dead_zone", "limit") + sonar.noise_std_m
    return replace(flight, sonar=replace(sonar, range_m=np.where(stuck, np.nan, sonar.range_m)))


def sonar_quantisation(flight: Flight, model: Model) -> Flight:
    """Add the rounding to the noise; the rounding itself cannot be undone."""
    sonar, step = _sonar(flight), model.value("sonar_quantisation", "step")
    noise_std_m = float(np.hypot(sonar.noise_std_m, step / np.sqrt(12.0)))
    return replace(flight, sonar=replace(sonar, noise_std_m=noise_std_m))


def sonar_bias(flight: Flight, model: Model) -> Flight:
    """Undo a constant offset."""
    shifted = _shifted(_sonar(flight), model.value("sonar_bias", "b"))
    return replace(
        flight, sonar=replace(shifted, datum_std_m=model.known_to("sonar_bias", shifted.datum_std_m))
    )


def sonar_scale(flight: Flight, model: Model) -> Flight:
    """Undo the scale of ranges."""
    divided = _divided(_sonar(flight), 1 + model.value("sonar_scale", "eps"))
    return replace(flight, sonar=replace(divided, scale_std=model.known_to("sonar_scale", divided.scale_std)))


def sonar_temperature(flight: Flight, model: Model) -> Flight:
    """Undo the change of the speed of sound in air that warms up over the flight."""
    sonar = _sonar(flight)
    progress = (sonar.stamps_s - sonar.stamps_s[0]) / max(float(np.ptp(sonar.stamps_s)), 1e-9)
    assumed = SOUND_M_S + SOUND_M_S_K * ASSUMED_DEG_C
    sound = assumed + SOUND_M_S_K * model.value("sonar_temperature", "rise") * progress
    return replace(flight, sonar=replace(sonar, range_m=sonar.range_m * sound / assumed))


def sonar_slant(flight: Flight, model: Model) -> Flight:
    """Convert to ranges of a pencil beam: the back end expects ranges along the beam."""
    sonar, pencil = _sonar(flight), model.value("sonar_slant", "c")
    slant = 1.0 / np.maximum(up_at(flight.attitude, sonar.stamps_s)[:, 2], 0.1)
    return replace(flight, sonar=replace(sonar, range_m=sonar.range_m * slant / (1 + pencil * (slant - 1))))


def sonar_tilt(flight: Flight, model: Model) -> Flight:
    """Set the mount to the true direction of the beam."""
    sonar, turn = _sonar(flight), np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([*model.vector("sonar_tilt"), 0.0]).as_matrix()
    b_T_s = turn @ sonar.b_T_s
    b_T_s[:3, 3] = sonar.b_T_s[:3, 3]
    return replace(flight, sonar=replace(sonar, b_T_s=b_T_s))


def _shifted(sonar: Sonar, by_m: float) -> Sonar:
    """Subtract ``by_m`` from readings and limits, so that valid readings stay valid."""
    return replace(
        sonar,
        range_m=sonar.range_m - by_m,
        min_range_m=max(0.0, sonar.min_range_m - by_m),
        max_range_m=sonar.max_range_m - by_m,
    )


def _divided(sonar: Sonar, by: float) -> Sonar:
    return replace(
        sonar,
        range_m=sonar.range_m / by,
        noise_std_m=sonar.noise_std_m / by,
        min_range_m=sonar.min_range_m / by,
        max_range_m=sonar.max_range_m / by,
    )


def _sonar(flight: Flight) -> Sonar:
    assert flight.sonar is not None
    return flight.sonar
