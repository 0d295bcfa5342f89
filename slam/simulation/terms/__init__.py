"""The catalogue: all terms of a model, by their canonical names.

A term is one object, and everything that is particular to it is in its file. Every module of this folder that
has terms belongs to the catalogue. The simulator and criticism share the objects: one simulates them, the
other selects and fits them.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from slam.simulation.terms.term import Parameter, Term

__all__ = ["CATALOGUE", "Parameter", "Term"]


def _terms() -> list[Term]:
    """Return the terms of all modules, by the modules' names; within one, in the order in which they act."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    tuples = [value for module in modules for value in vars(module).values() if isinstance(value, tuple)]
    return [term for values in tuples for term in values if isinstance(term, Term)]


CATALOGUE: dict[str, Term] = {term.name: term for term in _terms()}
