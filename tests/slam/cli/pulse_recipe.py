"""A recipe that flies a script, ``pulse.csv`` beside it, without a camera."""

RECIPE = """name = "pulse"
camera = "none"
[maneuver]
script = "pulse.csv"
height_m = 1.2
[world]
extent_m = [-20, -20, 20, 20]
"""
