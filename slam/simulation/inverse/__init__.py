"""What a model says of the instruments, taken out of a recorded flight."""

from slam.simulation.inverse.correct import CorrectedFlight, changes_readings, correct_flight

__all__ = ["CorrectedFlight", "changes_readings", "correct_flight"]
