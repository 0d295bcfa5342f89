"""Metric scale, accelerometer bias and lever arm from a visual path and inertial readings."""
