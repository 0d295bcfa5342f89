"""What a model says of the instruments, taken out of a recorded flight."""

from slam.simulation.inverse.corrected import Corrected, changes_readings, corrected

__all__ = ["Corrected", "changes_readings", "corrected"]
