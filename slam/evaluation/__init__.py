"""How good an estimate is: trajectory errors, consistency, landmark distances, loops."""

from slam.evaluation.score import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
