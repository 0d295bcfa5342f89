"""Clocks of pictures and instruments: delays, steps and drift between them, from how the vehicle turned."""
