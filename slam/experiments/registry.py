"""The experiments by name; each module is imported on demand."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module

from slam.core.errors import InputError
from slam.experiments.experiment import Experiment

NAMES = (
    "table1",
    "table2",
    "feature_distance",
    "table3",
    "table5",
    "hover",
    "pulses",
    "squares",
    "eights",
    "overlap_speed",
    "arithmetic",
)
"""Names in the order of the paper; each is a module of this package with an ``EXPERIMENT``."""
OTHER_NAMES = {"table4": "table3"}
"""Tables that belong to the experiment of another one."""


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Return the experiments of these names, or all without names, in the order of the paper.

    Raises ``InputError`` for an unknown name and suggests the nearest one.
    """
    for name in names:
        if name not in NAMES and name not in OTHER_NAMES:
            near = get_close_matches(name, [*NAMES, *OTHER_NAMES], n=1, cutoff=0.0)[0]
            raise InputError(
                f"{name}: no such experiment; did you mean {near!r}? there are: {', '.join(NAMES)}"
            )
    asked = {OTHER_NAMES.get(name, name) for name in names}
    return tuple(name for name in NAMES if name in asked or not names)


def experiment(name: str) -> Experiment:
    """Return the experiment of a known name."""
    found = import_module(f"slam.experiments.{name}").EXPERIMENT
    assert isinstance(found, Experiment)
    return found
