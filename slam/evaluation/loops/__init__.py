"""How well places seen before are recognised: precision and recall of a flight's loop closure."""

from slam.evaluation.loops.comparison import LoopEvaluation, evaluate_loops

__all__ = ["LoopEvaluation", "evaluate_loops"]
