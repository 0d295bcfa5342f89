"""Model criticism names what a simulation gets wrong about measured flights, with the gain in prediction.

An extended Kalman filter runs over each flight under a model. The whitened innovations are compared with the
sensitivity of each term of the catalogue.
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
    """Import on first use, as compiling the kernels takes time."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'slam.criticism' has no attribute {name!r}")
