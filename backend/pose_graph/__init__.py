"""Pose graphs: relative poses and sensor readings in, the most likely trajectory out."""
