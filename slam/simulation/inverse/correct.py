"""Correction of a flight by a model of its instruments, so that the map profits from criticism.

Each term that changes readings is undone, in the reverse order of `slam.simulation`: clocks first, and the
terms of one instrument in the reverse order of the catalogue. Terms of the vehicle and of the place stay. So
do the individual differences of healthy instruments, such as the sonar's zero: the map estimates them itself.
Where the model has a standard deviation of a term, it replaces the manufacturer's figure for the back end.
"""

from __future__ import annotations

from dataclasses import dataclass

from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE, Term


@dataclass(frozen=True)
class CorrectedFlight:
    """A corrected flight, and the terms that were and were not corrected."""

    flight: Flight
    corrected_terms: tuple[str, ...]
    """Terms with their values, as text."""
    uncorrected: tuple[str, ...]
    """Names of terms that cannot be undone: their effect is a loss or random."""

    def summary(self, model: Model) -> Message:
        """Return one line about the corrected and the uncorrected terms."""
        done = ", ".join(self.corrected_terms) or "nothing that changes a reading of this flight"
        rest = f"left as it is: {', '.join(self.uncorrected)}" if self.uncorrected else ""
        return warning(f"model {model.name!r} taken out of the readings: {done}", rest)


def corrections() -> list[Term]:
    """Return the terms that can be undone, in the order of correction."""
    terms = [term for term in reversed(CATALOGUE.values()) if term.undo is not None]
    return sorted(terms, key=lambda term: term.acts_on != "clock")


def correct_flight(flight: Flight, model: Model) -> CorrectedFlight:
    """Return the flight as healthy instruments would have recorded it, according to the model."""
    corrected_terms = []
    for term in corrections():
        changes = model.holds(term.name) and (not term.stream or getattr(flight, term.stream) is not None)
        if changes and term.undo is not None:
            flight = term.undo(flight, model.vector(term.name), model.known_to(term.name))
            corrected_terms.append(f"{term.name} ({_values(model, term)})")
    uncorrected = tuple(
        name for name in model.terms
        if CATALOGUE[name].is_of_instrument and CATALOGUE[name].undo is None and model.holds(name)
    )  # fmt: skip
    return CorrectedFlight(flight, tuple(corrected_terms), uncorrected)


def _values(model: Model, term: Term) -> str:
    return ", ".join(
        f"{p.name} {model.value(term.name, p.name):.3g}{'' if p.unit == '1' else f' {p.unit}'}"
        for p in term.parameters
        if model.value(term.name, p.name) != p.neutral
    )
