"""The Kalman filter of a vehicle's instruments and its smoother: see `backend.ekf.track`."""
