"""Checks of the arguments of public functions: one line says what was expected and what came."""

from __future__ import annotations

from os import PathLike
from typing import Any


def check_type(value: Any, expected: type, name: str, reader: str = "") -> None:
    """Raise ``TypeError`` where ``value`` is no ``expected``; ``name`` is that of the argument.

    ``reader`` is the call that reads one from a path, for the remedy where a path was given.
    """
    if isinstance(value, expected):
        return
    remedy = f"; read it first: {reader}" if reader and isinstance(value, (str, PathLike)) else ""
    raise TypeError(f"{name}: expected {expected.__name__}, got {described(value)}{remedy}")


def described(value: Any) -> str:
    """Return a wrong argument for a person: a path as it is, of other values the type."""
    if isinstance(value, (str, PathLike)):
        return f"the path {str(value)!r}"
    return type(value).__name__
