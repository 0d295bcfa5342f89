"""The place of a simulated flight: floors, marks, obstacles and moving objects."""
