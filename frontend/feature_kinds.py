"""Which features there are: apart from what finds them, so that a command line lists them without OpenCV."""

from typing import Literal

FeatureKind = Literal["sift", "orb", "orb-teblid", "akaze", "surf"]
