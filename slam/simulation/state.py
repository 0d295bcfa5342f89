"""Names and indices of the state of the equations of motion.

Frames and signs are the flight format's: world z up, R_wb = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

STATE = (
    "x", "y", "z",  # position, world [m]
    "v_x", "v_y", "v_z",  # velocity that drag acts on, world [m/s]; the position moves with v + w
    "roll", "pitch", "yaw",  # [rad]
    "yaw_rate",  # derivative of yaw, not a body rate [rad/s]
    "hold_x", "hold_y",  # set point of position_hold [m]
)  # fmt: skip
"""Names of the state's entries, in order."""
(X, Y, Z, VX, VY, VZ, ROLL, PITCH, YAW, YAW_RATE, HOLD_X, HOLD_Y) = range(len(STATE))
