"""All message types that are read from ROS recordings."""

from __future__ import annotations

from slam.io.recordings.ros.driver_rules import DRIVER_RULES
from slam.io.recordings.ros.messages import STANDARD_RULES, RosRule
from slam.io.recordings.ros.px4 import PX4_RULES

RULES: tuple[RosRule, ...] = (*STANDARD_RULES, *DRIVER_RULES, *PX4_RULES)
"""The message types and what they become, in the order of preference."""
