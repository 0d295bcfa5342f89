"""How far an effect must stand out, and what that is."""

from __future__ import annotations

from slam.criticism.search.thresholds import CHANCE, load_thresholds


def test_higher_thresholds_tell_by_how_much_and_why():
    plain = load_thresholds()
    higher = plain.times(2.0, "it is another vehicle")
    assert higher.effects == 2.0 * plain.effects
    assert higher.pairs == 2.0 * plain.pairs
    assert plain.meaning == CHANCE
    assert higher.meaning == f"2 times {CHANCE}, as it is another vehicle"
