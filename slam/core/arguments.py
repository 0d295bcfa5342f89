"""Checks of the arguments of public functions: one line says what was expected and what came."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from slam.core.estimate import Estimate
from slam.core.flight import Flight


def check_flight(value: Any, name: str = "flight") -> None:
    """Raise ``TypeError`` where ``value`` is no ``Flight``; ``name`` is that of the argument."""
    _check(value, Flight, name, "slam.read_flight(path)")


def check_estimate(value: Any, name: str = "estimate") -> None:
    """Raise ``TypeError`` where ``value`` is no ``Estimate``; ``name`` is that of the argument."""
    _check(value, Estimate, name, "slam.read_estimate(folder)")


def flight_tuple(flights: Iterable[Flight], name: str = "flights") -> tuple[Flight, ...]:
    """Return the flights of any iterable, a generator too. Raises ``TypeError`` where it holds others."""
    if isinstance(flights, Flight):
        raise TypeError(f"{name}: expected several flights, got one Flight; put it into a list")
    if isinstance(flights, (str, PathLike)) or not isinstance(flights, Iterable):
        raise TypeError(f"{name}: expected an iterable of Flight, got {_described(flights)}")
    found = tuple(flights)
    for k, flight in enumerate(found):
        check_flight(flight, f"{name}[{k}]")
    return found


def _check(value: Any, expected: type, name: str, reader: str) -> None:
    if isinstance(value, expected):
        return
    remedy = f"; read it first: {reader}" if isinstance(value, (str, PathLike)) else ""
    raise TypeError(f"{name}: expected {expected.__name__}, got {_described(value)}{remedy}")


def _described(value: Any) -> str:
    if isinstance(value, (str, PathLike)):
        return f"the path {str(value)!r}"
    return type(value).__name__
