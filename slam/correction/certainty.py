"""How surely a term is known once it is taken out."""

from __future__ import annotations

from slam.simulation.model import Model


def known_to(model: Model, term: str, otherwise: float) -> float:
    """Standard deviation of the vaguest of a term's parameters; ``otherwise`` where the model tells none."""
    return max(model.std.get(term, {}).values(), default=otherwise)
