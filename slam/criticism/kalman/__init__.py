"""Kalman filter of a flight: whitened innovations, and their sensitivity to each filter parameter."""
