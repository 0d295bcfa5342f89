"""Likelihood of a flight's pictures: the positions and the appearance of matched points."""
