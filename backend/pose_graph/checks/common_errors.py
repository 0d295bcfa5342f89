"""Errors that many accepted loops have in common, although each passes its own test."""

from __future__ import annotations

from collections.abc import Sequence

from backend.pose_graph.checks.score_test import LinearisedEdges
from backend.pose_graph.checks.shared_offset import LoopOffsets, shared_offset
from backend.pose_graph.checks.shifted_loops import shift_columns, shifted_loops


def common_errors(parts: Sequence[LinearisedEdges]) -> list[str]:
    """Return a sentence for each part whose loops have shifted vertex numbers.

    Without any such part, return one for each part in which some loops have a common offset.
    """
    shifted: list[str] = []
    offset: list[str] = []
    for part in parts:
        offsets = LoopOffsets.of(part)
        by_shift, by_offset = part.score_tests(shift_columns(part), offsets.columns)
        shifted += shifted_loops(part.problem, by_shift)
        offset += shared_offset(offsets, by_offset)
    return shifted or offset
