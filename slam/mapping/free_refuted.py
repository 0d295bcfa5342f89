"""Calibrations that a finished map refutes, tried as free parameters before the flight is mapped again."""

from __future__ import annotations

from dataclasses import replace

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.range_evidence import RangePrior
from slam.core.imu_at_rest import gravity_reading
from slam.core.instrument_readings import inertial_readings
from slam.core.lens_priors import as_assumed, as_nominal
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M
from slam.mapping.calibration.height_sensor import range_prior, ranges_by_evidence, suspected_ranges
from slam.mapping.calibration.refuted import (
    FreeCalibrations,
    Refuted,
    is_stated_lens_doubted,
    lens_by_evidence,
    refuted_by_trial,
    suspects,
    with_lens_of,
)
from slam.mapping.context import Context
from slam.mapping.map import Map
from slam.mapping.refine import refine_map


def free_refuted_calibrations(
    context: Context, refined: Map, errors: SystematicErrors | None, lens_is_suspect: bool
) -> FreeCalibrations | None:
    """Return the stated instruments with the calibrations as free parameters that the flight refutes.

    They are fixed ones whose ``errors`` displace the poses by more than their covariances state, a lens of
    another model, and one that is stated as more certain than the evidence says, which is computed where the
    lens is doubted or suspect. The height sensor comes last: a wrong lens makes the heights of the pictures
    disagree with those of a right sensor. The result is None where nothing is refuted.
    """
    camera, ranges = context.job.camera, range_prior(context.flight)
    seen = _freed_by_pictures(context, refined, errors, lens_is_suspect)
    if seen is not None and not seen.changes_nothing(camera):
        return seen
    freed = _freed_ranges(context, refined)
    if freed is None:
        return seen
    return FreeCalibrations(camera, context.flight.gps, freed, (Refuted("height sensor", None, ranges),))


def _freed_by_pictures(
    context: Context, refined: Map, errors: SystematicErrors | None, lens_is_suspect: bool
) -> FreeCalibrations | None:
    """Return the instruments with the lens or the antenna free, or why they are fixed; None without doubt."""
    camera, gps, ranges = context.job.camera, context.flight.gps, range_prior(context.flight)
    if refined.camera.lens != camera.lens:
        return FreeCalibrations(with_lens_of(camera, refined.camera), gps, ranges)
    suspected = suspects(refined.bundle, errors)
    if errors is None or not suspected.refuted:
        doubted = lens_is_suspect or is_stated_lens_doubted(camera, refined)
        return _with_doubted_lens_free(context, refined) if doubted else None
    with context.timer("refine"):
        trial = refine_map(refined, suspected.free(context.setup), context.job.progress)
    refuted, reason = refuted_by_trial(trial.bundle, suspected, errors)
    for each in refuted:
        if each.what == "lens":
            camera = with_lens_of(as_nominal(camera), trial.camera)
        elif gps is not None:
            gps = replace(gps, antenna_std_m=NOMINAL_ANTENNA_STD_M)
    return FreeCalibrations(camera, gps, ranges, refuted, reason)


def _freed_ranges(context: Context, refined: Map) -> RangePrior | None:
    """Return how well gain and zero of the height sensor are known, if the flight refutes what is stated.

    An accelerometer whose reading of gravity is off may be the wrong one itself: it proves nothing.
    """
    stated, imu = range_prior(context.flight), context.flight.imu
    if imu is not None and gravity_reading(imu) is not None:
        refined, imu = replace(refined, inertial=None), None
    with context.timer("refine"):
        widest = suspected_ranges(stated, refined)
        if stated is None or widest is None:
            return None
        setup, readings = context.setup.with_range_prior(widest), inertial_readings(imu)
        return ranges_by_evidence(stated, refine_map(refined, setup, context.job.progress, readings))


def _with_doubted_lens_free(context: Context, refined: Map) -> FreeCalibrations | None:
    """Return the lens with a wider prior, if its evidence is much stronger than that of the stated one."""
    camera = context.job.camera
    with context.timer("refine"):
        widest = replace(context.setup, camera=as_assumed(camera))
        found, doubted = lens_by_evidence(camera, refine_map(refined, widest, context.job.progress))
    refuted = () if found is camera else (Refuted("lens", None),)
    ranges = range_prior(context.flight)
    return FreeCalibrations(found, context.flight.gps, ranges, refuted, doubted_lens=doubted)
