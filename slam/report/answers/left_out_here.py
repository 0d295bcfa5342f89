"""Data that a map was made without, with advice that fits this map where it would depend on the case."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from backend.wording import counted
from slam.core.estimate import Estimate
from slam.report.answers.failures import too_bare
from slam.report.answers.left_out import CUT_THERE, FLY_AGAIN, SLOWER, LeftOut, left_out
from slam.report.facts import Facts

if TYPE_CHECKING:
    from slam.core.summary import Summary

_VISIBLE_PX = 1.0
"""A smaller shift at a seam is within a pixel of the mosaic, and cannot be seen."""


def left_out_here(estimate: Estimate, facts: Facts, summary: Summary) -> tuple[LeftOut, ...]:
    """Return the rows of the table, those that may call for an action first."""
    return left_out(summary.rejected, {} if facts.is_graph else _here(estimate, facts, summary))


def ground_is_missing(facts: Facts, summary: Summary) -> bool:
    """Return whether the path crosses ground that no usable picture may show."""
    return any(gap.shows_nothing for gap in facts.gaps) or bool(too_bare(facts, summary))


def _here(estimate: Estimate, facts: Facts, summary: Summary) -> Mapping[str, str]:
    """Return advice for a case -> advice for this map; what it does not tell stays as it is."""
    found = {
        SLOWER: "No: the map is in one piece all the same."
        if facts.in_one_piece
        else f"Yes: the map is in {facts.maps} parts. Fly slower there, or record more pictures a second."
    }
    if ground_is_missing(facts, summary):
        found[FLY_AGAIN] = (
            "Only if you need what lies below the path there: this map lacks some of it (“Is any of the "
            "ground missing?” names it). Fly it again, with more light, higher, or with marks on it."
        )
    elif facts.placed == facts.keyframes:
        found[FLY_AGAIN] = "No: no stretch of the path is without other pictures."
    if estimate.ground is not None:
        shift_px = estimate.ground.misregistration_px[-1]
        fit = f"at the seams the pictures fit to {_in_pixels(shift_px)} on 95 % of the ground"
        if shift_px <= _VISIBLE_PX:
            found[CUT_THERE] = f"No: the map does not use them, and {fit}."
        elif shift_px > _VISIBLE_PX:  # NaN where it was not measured, and then neither is said
            found[CUT_THERE] = (
                f"Only if you see the mosaic cut or doubled where many of them lie: {fit}, which shows. "
                "Look there in map.html, and fly that place again with more overlap."
            )
    return found


def _in_pixels(shift_px: float) -> str:
    """Return a shift in pixels of the mosaic, in words."""
    return counted(1, "pixel") if f"{shift_px:.2g}" == "1" else f"{shift_px:.2g} pixels"
