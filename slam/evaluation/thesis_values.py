"""Figures quoted from the thesis of the paper's second author, on the same drone, for comparison with ours.

Source: N. Dijkshoorn, "Simultaneous localization and mapping with the AR.Drone", master's thesis, University
of Amsterdam, 2012. Errors are mean distances to the position that a laser measured.
"""

from __future__ import annotations

MAGAZINES, FEW_LINES, HALL = "magazines", "few lines", "sports hall"

PATH_M = {MAGAZINES: 66.7, FEW_LINES: 19.6, HALL: 102.0}
"""Length of the flown path."""
VELOCITY_MM = {MAGAZINES: 477.0, FEW_LINES: 1292.0, HALL: 988.0}
"""On-board velocity, integrated."""
VISUAL_MM = {MAGAZINES: 552.0, FEW_LINES: 1126.0, HALL: 4251.0}
"""Visual odometry."""
LOCALISED_MM = {MAGAZINES: 324.0, HALL: 1158.0}
"""Visual odometry, localised against the map made in flight; not possible on few lines."""

RESOLUTION_M = {33: 11.7, 67: 2.17, 90: 0.531, 100: 0.579}
"""Percent of 176 x 144 pixels -> error of visual odometry on the magazines, real drone."""
SIMULATED_RESOLUTION_M = {33: 15.3, 67: 0.601, 100: 0.058, 133: 0.105, 200: 0.128}
"""The same in the thesis's simulator, where more pixels cost pictures."""

FREEDOM_MM = {"translation": 552.0, "Euclidean": 967.0, "homography": 8923.0}
"""Error on the magazines by what a pair of pictures may determine: the rest is from the inertial unit."""
