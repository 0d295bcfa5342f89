"""Velocity and yaw that a vehicle reports, as factors of the refinement."""
