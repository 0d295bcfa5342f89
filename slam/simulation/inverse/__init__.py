"""Correction of recorded flights for the errors of their instruments, by a model."""

from slam.simulation.inverse.correct import CorrectedFlight, changes_readings, correct_flight

__all__ = ["CorrectedFlight", "changes_readings", "correct_flight"]
