"""The landmark figures of the IMAV 2011 paper's figure eight, to stand beside ours.

Source: Visser, Dijkshoorn, van der Veen, Jurriaans, "Closing the gap between simulation and reality in the
sensor and motion models of an autonomous AR.Drone", IMAV 2011, tables 3 and 4.
"""

from __future__ import annotations

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
