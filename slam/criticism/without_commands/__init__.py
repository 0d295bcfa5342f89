"""Flights without a command log: nobody knows what moved the vehicle, so its instruments judge each other."""
