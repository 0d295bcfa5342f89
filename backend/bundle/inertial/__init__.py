"""Readings of an IMU as factors of the refinement."""
