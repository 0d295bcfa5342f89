"""Limits beyond which integrated readings are not believed."""

from __future__ import annotations

MOST_SIGMAS = 4.0
"""Largest errors of right readings, in standard deviations."""
MOST_HEIGHTS = 1.0
"""Largest standard deviation of a position behind a gap between pictures, in heights above the floor: beyond
it the pictures could be anywhere."""
