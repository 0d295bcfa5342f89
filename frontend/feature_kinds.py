"""Kinds of features. They are apart from the detectors, so that a command line lists them without OpenCV."""

from typing import Literal

FeatureKind = Literal["sift", "orb", "orb-teblid", "akaze", "surf"]
