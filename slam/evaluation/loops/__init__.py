"""Precision and recall of the loop closure of a flight."""

from slam.evaluation.loops.comparison import LoopEvaluation, evaluate_loops

__all__ = ["LoopEvaluation", "evaluate_loops"]
