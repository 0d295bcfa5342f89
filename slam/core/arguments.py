"""Checks of flights and estimates that public functions are given."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from backend.arguments import check_type, described
from slam.core.estimate import Estimate
from slam.core.flight import Flight


def check_flight(value: Any, name: str = "flight") -> None:
    """Raise ``TypeError`` where ``value`` is no ``Flight``; ``name`` is that of the argument."""
    check_type(value, Flight, name, "slam.read_flight(path)")


def check_estimate(value: Any, name: str = "estimate") -> None:
    """Raise ``TypeError`` where ``value`` is no ``Estimate``; ``name`` is that of the argument."""
    check_type(value, Estimate, name, "slam.read_estimate(folder)")


def flight_tuple(flights: Iterable[Flight], name: str = "flights") -> tuple[Flight, ...]:
    """Return the flights of any iterable, a generator too. Raises ``TypeError`` where it holds others."""
    if isinstance(flights, Flight):
        raise TypeError(f"{name}: expected several flights, got one Flight; put it into a list")
    if isinstance(flights, (str, PathLike)) or not isinstance(flights, Iterable):
        raise TypeError(f"{name}: expected an iterable of Flight, got {described(flights)}")
    found = tuple(flights)
    for k, flight in enumerate(found):
        check_flight(flight, f"{name}[{k}]")
    return found
