"""Instrument errors in words."""

from __future__ import annotations

from slam.core.instrument_errors import LensNumber
from slam.core.units import SPACE
from slam.report.instrument_errors import held_lens_text, lens_text


def test_the_numbers_of_a_lens_are_estimated_or_held():
    lens = {
        "cx": LensNumber(788.77, 0.846, 780.458, 16.0, estimated=True),
        "p1": LensNumber(0.001169, 0.0000512, 0.0040638, 0.002, estimated=True),
        "k3": LensNumber(-0.2789, 0.0167, -0.2643, 0.02, estimated=False),
    }
    estimated = (
        "cx 788.77 ± 0.85 (before the flight: 780.46), p1 0.001169 ± 5.1e-05 (before the flight: 0.004064)"
    )
    assert lens_text(lens).replace(SPACE, " ") == estimated
    assert held_lens_text(lens).replace(SPACE, " ") == "k3 -0.2643 ± 0.02"
    assert lens_text(None) == held_lens_text(None) == ""
