"""Readings of gyro and accelerometer, integrated between known times."""
