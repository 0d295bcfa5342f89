"""Correction of recorded flights for the errors of their instruments, by a model."""

from slam.simulation.inverse.correct import CorrectedFlight, correct_flight, corrections

__all__ = ["CorrectedFlight", "correct_flight", "corrections"]
