"""Instrument errors in words."""

from __future__ import annotations

from slam.core.instrument_errors import LensNumber, RollingShutter
from slam.core.units import SPACE
from slam.report.tables.instrument_errors import lens_text, shutter_text


def test_the_numbers_of_a_lens_are_told_by_the_flight_or_before_it():
    lens = {
        "cx": LensNumber(788.77, 0.846, 780.458, 16.0, estimated=True),
        "p1": LensNumber(0.001169, 0.0000512, 0.0040638, 0.002, estimated=True),
        "k3": LensNumber(-0.2789, 0.0167, -0.2643, 0.02, estimated=False),
    }
    estimated = "cx 788.8 ± 0.8 (before the flight: 780.5), p1 0.00117 ± 0.00005 (before the flight: 0.00406)"
    assert lens_text(lens).replace(SPACE, " ") == estimated
    held = lens_text(lens, estimated=False).replace(SPACE, " ")
    assert held == "k3 -0.279 ± 0.017 (before the flight: -0.264 ± 0.020)"
    assert lens_text(None) == lens_text(None, estimated=False) == ""


def test_a_shutter_is_estimated_stated_or_taken_as_global():
    found = RollingShutter(0.0301, 0.0012, 0.04, estimated=True, known_velocities=60)
    words = shutter_text(found).replace(SPACE, " ")
    assert words == (
        "rolling: 30.1 ± 1.2 ms from the first row to the last, estimated by the motion of 60 pictures"
    )
    refuted = RollingShutter(0.0301, 0.0012, 0.04, estimated=True, known_velocities=60, stated_s=0.018)
    assert shutter_text(refuted).replace(SPACE, " ") == f"{words}; 18 ms are stated"
    fixed = RollingShutter(0.0, 0.0012, 0.04, estimated=False, known_velocities=60)
    assert shutter_text(fixed) == (
        "taken as global: the motion of 60 pictures shows no rolling shutter, and tells its time to 1.2 ms"
    )
    stated = RollingShutter(0.03, 0.0, 0.0, estimated=False, known_velocities=60)
    assert shutter_text(stated) == "rolling: 30 ms from the first row to the last, as stated"
    assert shutter_text(None) == ""
