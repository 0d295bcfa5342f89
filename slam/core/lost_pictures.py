"""Reasons for which pictures are lost to a map, and the share of them that is worth telling."""

SHOW_NOTHING = ("same picture as the one before", "too few features")
"""Words of `frontend.views` and `frontend.keyframes`, which load OpenCV."""
BARE_GROUND = "bare ground"
"""Beginning of a warning about pictures that show nothing."""
TRACKING_LOST = "tracking started anew"
"""Word of `frontend.keyframes` for a picture that nothing links to the one before."""
REDUNDANT = "other pictures show its ground"
"""Reason of a usable keyframe that the mosaic does not need."""
NOTABLE_SHARE = 0.02
"""Share of pictures above which one reason to leave them out, or something moving, is reported."""
