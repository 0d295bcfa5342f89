"""Parts of a map that the readings of the IMU connect."""
