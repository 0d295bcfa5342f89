"""Refinements of cameras with a rolling shutter, also as if all rows were exposed at once."""

from __future__ import annotations

from dataclasses import replace

from backend.bundle.refinement import Bundle, refine
from tests.backend.made_floor import Made

READOUT_S = 0.03


def refined(made: Made) -> Bundle:
    return refine(made.measurements, made.start, made.floor_z_m)


def as_global(made: Made) -> Bundle:
    return refined(replace(made, measurements=replace(made.measurements, exposure=None)))
