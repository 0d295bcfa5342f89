"""Errors of the instruments that the map determines: clock, mount, rolling shutter, scale, offsets."""
