"""Estimation of a pose graph that grows by one keyframe after the other."""
