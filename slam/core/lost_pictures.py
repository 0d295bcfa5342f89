"""Reasons for which pictures show nothing of the ground, and the share of them that is worth telling."""

SHOW_NOTHING = ("same picture as the one before", "too few features")
"""Words of `frontend.views` and `frontend.keyframes`, which load OpenCV."""
NOTABLE_SHARE = 0.02
"""Share of pictures above which one reason to leave them out, or something moving, is reported."""
