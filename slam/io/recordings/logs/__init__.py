"""Logs of autopilots: PX4, ArduPilot, MAVLink and the AR.Drone."""
