"""Errors of instruments of small vehicles that nobody states, as standard deviations.

They are the defaults of the Kalman filter, of the factors of a map, and of the settings.
"""

from __future__ import annotations

GYRO_OFFSET_RAD_S = 0.02
"""Zero of a gyro. That of the catalogue of effects lies within 2 deg/s, anywhere: 0.035 / sqrt(3)."""
ACCEL_OFFSET_M_S2 = 0.3
"""Zero of an accelerometer. That of common sensors lies within 50 mg, anywhere: 0.49 / sqrt(3) (InvenSense
MPU-6050 product specification 3.4, section 6.2)."""
GYRO_GAIN_RATIO = 0.03
"""Relative error of the gains of a gyro, as large as the tolerance of common sensors (the same, section
6.1)."""
ACCEL_GAIN_RATIO = 0.02
"""The same of an accelerometer. That of common sensors lies within 3 %, anywhere: 0.03 / sqrt(3) (the same,
section 6.2)."""
ACCEL_WALK_M_S3 = 1e-3
"""Random walk of the zero of an accelerometer, per root Hz."""
VELOCITY_ERROR_M_S = 0.06
"""Lasting error of the velocity that a vehicle reports, besides its gain: that of an AR.Drone against motion
capture."""
RANGE_FLOOR_M = 0.005
"""Least white noise of a range, whatever its sensor states. That of readings in whole centimetres is
0.003 m, and few floors are flatter."""
BAROMETER_FLOOR_M = 0.1
"""Least white noise of a barometric height, whatever its sensor states: 1.2 Pa, the dynamic pressure of a
draft of 1.4 m/s."""
BAROMETER_WALK_M = 0.1
"""Random walk of a barometric height, per root second."""
