"""Output of ``slam loops``: loops.json, summary.json, and the table on the terminal."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from slam.core.figure_table import UNKNOWN, FigureTable
from slam.core.summary import peak_rss_mb
from slam.evaluation.loops.comparison import LoopEvaluation, MethodScore
from slam.evaluation.loops.curve import Curve

MOST_THRESHOLDS = 200
"""Largest number of points of each curve in loops.json."""

EXPLAINED = (
    "Average precision: area under the curve of precision over recall; 1 where all true loops rank before "
    "all false ones.",
    "Recall at full precision: share of all true loops that a method ranks before its first false one.",
)
"""Explanation of the table's columns."""


def full_record(evaluation: LoopEvaluation) -> dict[str, Any]:
    """Return the content of loops.json: the figures and the curves."""
    return {
        **figures(evaluation),
        "curves": {
            method.name: {
                "candidates": None if method.candidates is None else _points(method.candidates),
                "after_verification": _points(method.after_verification),
            }
            for method in evaluation.methods
        },
        "kept": [list(pair) for pair in evaluation.kept],
    }


def summary_record(evaluation: LoopEvaluation) -> dict[str, Any]:
    """Return the content of summary.json."""
    return {
        "status": evaluation.status,
        **figures(evaluation),
        "timing_s": {stage: round(seconds, 4) for stage, seconds in evaluation.timing_s.items()},
        "peak_rss_mb": round(peak_rss_mb(), 1),
        "warnings": list(evaluation.warnings),
    }


def figures(evaluation: LoopEvaluation) -> dict[str, Any]:
    """Return the figures without the curves."""
    return {
        "name": evaluation.name,
        "reference": evaluation.reference.kind,
        "position_std_m": evaluation.reference.position_std_m,
        "frames": evaluation.frames,
        "keyframes": evaluation.keyframes,
        "compared": evaluation.compared,
        "pairs": evaluation.pairs,
        "true_pairs": evaluation.true_pairs,
        "neighbours": evaluation.neighbours,
        "methods": {method.name: _method(method) for method in evaluation.methods},
        "stages": {stage.name: asdict(stage.counts) for stage in evaluation.stages},
        "all_true_pairs": evaluation.all_true_pairs,
    }


def table(evaluation: LoopEvaluation) -> FigureTable:
    """Return the table: a line for each method, and one for the map."""
    rows = []
    for method in evaluation.methods:
        before, after = method.candidates, method.after_verification
        alone = (UNKNOWN, UNKNOWN)
        if before is not None:
            alone = (_share(before.area), _percent(before.full_precision_recall))
        rows.append(
            (
                method.name,
                *alone,
                f"{method.proposed.true} / {method.proposed.false}",
                f"{method.verified.true} / {method.verified.false}",
                _share(after.area),
                _percent(after.full_precision_recall),
            )
        )
    kept = evaluation.stages[-1].counts
    kept_of = f"{kept.true} of {evaluation.all_true_pairs} / {kept.false}"
    rows.append(("our map", "", "", "", kept_of, "", ""))
    columns = (
        "", "by similarity:\naverage\nprecision", "\nrecall at full\nprecision", "\n\nproposed",
        "registered:\n\naccepted", "\naverage\nprecision", "\nrecall at full\nprecision",
    )  # fmt: skip
    return FigureTable(
        f"{evaluation.name}: {evaluation.true_pairs} true loops among {evaluation.pairs} pairs of "
        f"{evaluation.compared} keyframes; pairs as true / false",
        columns,
        tuple(rows),
    )


def _method(method: MethodScore) -> dict[str, Any]:
    record: dict[str, Any] = {"proposed": asdict(method.proposed), "verified": asdict(method.verified)}
    for name, curve in (("candidates", method.candidates), ("after_verification", method.after_verification)):
        if curve is not None:
            record[name] = {"area": curve.area, "recall_at_full_precision": curve.full_precision_recall}
    return record


def _points(curve: Curve) -> dict[str, list[float]]:
    thin = curve.thinned(MOST_THRESHOLDS)
    return {name: getattr(thin, name).tolist() for name in ("threshold", "precision", "recall")}


def _share(value: float) -> str:
    return UNKNOWN if value != value else f"{value:.3f}"


def _percent(value: float) -> str:
    return UNKNOWN if value != value else f"{100 * value:.1f} %"
