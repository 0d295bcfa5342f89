"""Figures quoted from the IMAV 2011 paper, for comparison with ours.

Source: Visser, Dijkshoorn, van der Veen, Jurriaans, "Closing the gap between simulation and reality in the
sensor and motion models of an autonomous AR.Drone", IMAV 2011.
"""

from __future__ import annotations

SQUARE_DRONE_PERCENT = {"A-B": 29.6, "B-C": 11.2, "C-D": 46.8, "D-A": 12.0, "B-D": 24.1}
"""Table 1: errors of landmark distances on the square, real AR.Drone."""
SQUARE_DRONE_M = {"A-B": 0.385, "B-C": 0.146, "C-D": 0.608, "D-A": 0.156, "B-D": 0.445}

SQUARE_PERCENT = {"A-B": 1.46, "B-C": 3.62, "C-D": 2.00, "D-A": 5.77, "B-D": 2.15}
"""Table 1: errors of landmark distances on the square, simulation."""
SQUARE_M = {"A-B": 0.019, "B-C": 0.047, "C-D": 0.026, "D-A": 0.075, "B-D": 0.028}

WHITE_BALANCE_PERCENT = {"A-B": 2.21, "B-C": 12.93, "C-D": 15.36, "D-A": 18.14, "B-D": 10.27}
"""Table 2: errors of landmark distances on the square, simulation with the white-balance filter."""
WHITE_BALANCE_M = {"A-B": 0.031, "B-C": 0.181, "C-D": 0.215, "D-A": 0.254, "B-D": 0.190}

SIDE_M, DIAGONAL_M = 1.3, 1.84
"""Section 4.1: true distances between the square's landmarks."""

FEATURE_DISTANCE_PX = {"without": 22.1, "with": 32.9, "drone": 32.7}
"""Section 4.1: mean distance of features matched in consecutive pictures, without and with the filter."""

STITCHED_PERCENT = {
    "A-B": 10.48, "B-C": 19.33, "C-D": 27.57, "D-E": 4.89, "E-F": 24.90,
    "F-G": 0.24, "G-H": 11.62, "H-A": 17.51, "B-G": 2.20,
}  # fmt: skip
"""Table 3: real-time stitched map, error of a landmark distance in percent."""

EKF_PERCENT = {
    "A-B": 1.38, "B-C": 15.31, "C-D": 2.33, "D-E": 12.56, "E-F": 0.62,
    "F-G": 13.24, "G-H": 3.81, "H-A": 16.0, "B-G": 3.83,
}  # fmt: skip
"""Table 4: map based on the extended Kalman filter, error of a landmark distance in percent."""

STICKS = (0.05, 0.10, 0.15, 0.20, 0.25)
SPEED_M_S = dict(zip(STICKS, (0.4044, 0.6284, 1.4427, 1.7587, 2.2094), strict=True))
"""Table 5: mean speed and pitch of the real drone at the end of a pulse of 5 s, and standard deviations."""
SPEED_STD_M_S = dict(zip(STICKS, (0.096, 0.226, 0.070, 0.126, 0.165), strict=True))
PITCH_DEG = dict(zip(STICKS, (1.4654, 2.9025, 4.1227, 5.7457, 7.4496), strict=True))
PITCH_STD_DEG = dict(zip(STICKS, (0.455, 0.593, 0.482, 0.552, 0.921), strict=True))

SPEED_A_DEGREE = 0.2967
"""Equation 4: v = 0.2967 s theta_max, m/s and degrees."""
MAX_TILT_DEG = 30.0
P_THETA = 0.057
"""Section 4.2.2: tilt in rad at a speed of 1 m/s."""

HOVER_SPEED_M_S, HOVER_SPEED_VARIANCE = 0.0422, 0.0012
"""Section 4.2.1: the real drone over ten hovers of 35 s; mean speed, and "sample variance" in m^2/s^2."""
HOVER_DRIFT_M, HOVER_DRIFT_VARIANCE = 0.0707, 0.0012
"""Mean distance from the start, where the position is the integrated speed; variance in m^2."""

FIELD_OF_VIEW_DEG = 64.0
FLOOR_AT_1M_M = 1.24
"""Section 3.1: length of floor that the camera sees from a height of 1 m."""
OVERLAP_SPEED_M_S = {15.0: 9.3, 6.67: 4.13}
"""Section 3.1: pictures a second -> largest speed at which consecutive pictures overlap by half."""
TOP_SPEED_M_S, TOP_SPEED_PERCENT = 5.0, 83.0
"""Section 3.1: top speed of the drone, and 4.13 m/s as a percentage of it."""
