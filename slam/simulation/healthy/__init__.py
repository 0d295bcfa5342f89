"""Healthy vehicles: safe manoeuvres, motions by hand, and simulated flights."""
