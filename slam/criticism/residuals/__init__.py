"""Residual patterns that change no equation: anomalous readings, steps in the floor, vibration."""
