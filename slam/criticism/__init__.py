"""Model criticism: what a simulation gets wrong about measured flights, by name, with what it gains to know.

A flight is filtered under a model; what is left over, whitened, is compared with the trace that each term of
the catalogue would leave there.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam.criticism.run import criticise
    from slam.criticism.verdict.criticism import Criticism

__all__ = ["Criticism", "criticise"]

_HOME = {"Criticism": "slam.criticism.verdict.criticism", "criticise": "slam.criticism.run"}


def __getattr__(name: str) -> Any:
    """Import on first use: the kernels take their time."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'slam.criticism' has no attribute {name!r}")
