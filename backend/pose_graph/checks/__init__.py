"""Checks of a solved pose graph: what may be wrong with it, although its equations are solved."""
