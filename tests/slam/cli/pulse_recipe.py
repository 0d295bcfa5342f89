"""A recipe without a camera that flies the script ``pulse.csv``."""

RECIPE = """name = "pulse"
camera = "none"
[maneuver]
script = "pulse.csv"
height_m = 1.2
[world]
extent_m = [-20, -20, 20, 20]
"""
