"""Rows of a table about the truth itself: rows that cannot be used, its clock, and its unit of length."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted, either
from slam.core.units import length

if TYPE_CHECKING:
    from slam.evaluation.coarse_truth import FewRows
    from slam.evaluation.score import Evaluation
    from slam.evaluation.truth_clock import TruthClock

_UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "feet": 1 / 0.3048, "kilometres": 0.001}
_NEAR = 0.03
"""Relative difference from the factor of a unit: the lengths of a metric map are better known, and no two of
the units are so near."""
_LEFT_SHARE = 0.1
"""Share of the error that is left with another scale, where a unit explains it."""


def unit_of_truth(evaluation: Evaluation) -> str:
    """Return the unit that the lengths of the truth seem to have in place of metres; empty if they are
    metres, or if the map has none."""
    if not evaluation.metric or not evaluation.ate_sim3_m.rmse < _LEFT_SHARE * evaluation.ate_aligned_m.rmse:
        return ""
    return next((name for name, by in _UNITS.items() if abs(evaluation.scale / by - 1) < _NEAR), "")


def rows_about_truth(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return what is doubtful about the truth, as rows of a table."""
    rows = []
    if evaluation.incomplete_rows:
        rows.append(("rows of the truth without a whole pose", f"{evaluation.incomplete_rows}, left out"))
    unit = unit_of_truth(evaluation)
    if unit:
        rows.append(
            (
                "unit of the truth",
                f"its lengths are {evaluation.scale:.4g} times those of the map: they look like {unit};"
                " write them in metres, and evaluate again",
            )
        )
    if evaluation.truth_clock is not None:
        rows.append(("clock of the truth", clock_of_truth(evaluation.truth_clock)))
    if evaluation.too_few_rows is not None:
        rows.append(("rows of the truth", too_coarse_to_tell(evaluation.too_few_rows)))
    return rows


def too_coarse_to_tell(few: FewRows) -> str:
    """Return that the errors between rows may be those of the truth, those at rows, and what to do."""
    off = [f"{few.off_line_deg:.2g} deg"] * (few.off_line_deg > 0) + [length(few.off_line_m)] * (
        few.off_line_m > 0
    )
    error = few.ate_at_rows_m.rmse
    near = f"at the {counted(few.at_rows, 'keyframe')} nearest to rows the aligned position error is "
    near += f"typically {length(error)}" if np.isfinite(error) else "not told, they are too few"
    return (
        f"the truth is too coarse to tell whether the map is wrong, or the straight line between two rows: "
        f"{counted(few.keyframes, 'keyframe')} {either(few.keyframes, 'leaves', 'leave')} it by up to "
        f"{' and '.join(off)}; {near}; give more rows of the truth"
    )


def clock_of_truth(clock: TruthClock) -> str:
    """Return how late or early the truth's stamps look, and what to do."""
    way = "late" if clock.late_s > 0 else "early"
    return (
        f"the stamps of the truth look {abs(clock.late_s):.3f} s {way}: with that corrected, the aligned "
        f"position error is typically {length(clock.ate_aligned_m)}; correct them, and evaluate again"
    )
