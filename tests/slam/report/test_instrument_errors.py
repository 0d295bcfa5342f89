"""Instrument errors in words."""

from __future__ import annotations

from slam.report.instrument_errors import shares_text


def test_the_largest_share_of_each_direction_is_named():
    shares = {"x": {"pictures": 0.3, "range": 0.7}, "roll": {"flat_floor": 0.9, "pictures": 0.1}}
    assert shares_text(shares) == "x: range 70 %, roll: flat floor 90 %"
    assert shares_text({}) == ""
