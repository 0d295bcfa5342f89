"""Measures of the quality of an estimate: trajectory errors, consistency, landmark distances and loops."""

from slam.evaluation.score import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
