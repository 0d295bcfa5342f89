"""Counts in messages."""

from __future__ import annotations

from backend.wording import counted, either


def test_a_count_agrees_with_its_noun_and_verb():
    assert counted(1, "edge") == "1 edge"
    assert counted(0, "edge") == "0 edges"
    assert counted(3, "edge is", "edges are") == "3 edges are"
    assert either(1, "it", "them") == "it"
