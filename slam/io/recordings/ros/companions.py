"""Topics that are read only together with another one, and the reasons to doubt a topic.

The two halves of an IMU may be topics of their own (``/camera/gyro/sample``, ``/camera/accel/sample``). A
velocity in the world's axes needs the attitude of the vehicle to become one in those of the body.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.io.down_looking import MAX_TILT_DEG, Look, axis_tilt_deg
from slam.io.files import brief
from slam.io.recordings.ros.messages import IMU, ODOMETRY, RANGE_KINDS, RosRule, heading_axes
from slam.io.recordings.ros.open_bag import OpenBag
from slam.io.recordings.ros.rules import RULES
from slam.io.recordings.ros.transforms import is_body, is_north_east_down, is_optical, is_world

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Table = tuple[Stamps, Array]
"""Stamps (n,) [ns] and rows (n, c) of the messages of a topic."""

LONGEST_GAP_S = 0.25
"""Longest gap in the turns of the vehicle: between readings of a slow attitude."""
_COMMAND_WORDS = frozenset(("setpoint", "cmd", "command", "target", "reference", "desired"))
_MEASUREMENTS = ("attitude0", "velocity0", "gps0")
"""Streams whose message types also carry what the vehicle is told to do."""
_GYRO, _ACCEL = slice(0, 3), slice(3, 6)


@dataclass(frozen=True)
class Companion:
    """A topic that another one is read with."""

    topic: str
    rule: RosRule
    sentence: str
    """How the readings of the other topic are completed."""
    joined: Callable[[Array, Array], Array]
    """Return the rows of the other topic from themselves and the values of this one at the same times."""

    def complete(self, other: Table, own: Table, b_T_s: Array | None) -> Array:
        """Return the completed rows (n, c) of the other topic; NaN where this one has a gap.

        ``b_T_s`` (4, 4): mount of the sensor of this topic; None where it is unknown.
        """
        (stamps_ns, rows), (own_ns, own_rows) = other, own
        values = self.rule.values(own_rows, b_T_s)
        return self.joined(rows, _at(stamps_ns, own_ns, values, are_angles=self.rule.stream == "attitude0"))


def _at(stamps_ns: Stamps, own_ns: Stamps, own: Array, are_angles: bool) -> Array:
    """Return columns (n, c) between the readings of others; NaN in a gap, and before and after them.

    Angles [rad] may jump by a turn between readings.
    """
    own_ns, first = np.unique(own_ns, return_index=True)
    own = own[first]
    known = np.isfinite(own).all(axis=1)
    own_ns, own = own_ns[known], np.unwrap(own[known], axis=0) if are_angles else own[known]
    if len(own_ns) < 2:
        return np.full((len(stamps_ns), own.shape[1]), np.nan)
    at_s, own_s = (stamps_ns - own_ns[0]) * 1e-9, (own_ns - own_ns[0]) * 1e-9
    after = np.clip(np.searchsorted(own_s, at_s), 1, len(own_s) - 1)
    in_gap = (own_s[after] - own_s[after - 1] > LONGEST_GAP_S) | (at_s < own_s[0]) | (at_s > own_s[-1])
    found = np.column_stack([np.interp(at_s, own_s, column) for column in own.T])
    return np.where(in_gap[:, None], np.nan, found)


def companion_of(
    bag: OpenBag, rule: RosRule, topic: str, attitude: tuple[str, RosRule] | None = None
) -> Companion | None:
    """Return what a topic has to be read with; None for one that is complete, or without such a topic.

    ``attitude`` is the topic chosen as the attitude of the vehicle; None for the one that gives it best.
    """
    if rule.kind == IMU and rule.stream == "imu0" and (accel := _other_half(bag, topic, "gyro", "accel")):
        return Companion(accel, rule, f"the accelerometer is that of {accel}", _with_accel)
    frame = _frame(bag, rule, topic)
    if rule.stream != "velocity0" or rule.kind == ODOMETRY or not is_world(frame):
        return None
    attitude = attitude or _attitude(bag)
    if attitude is None:
        return None
    sentence = f"from the world's axes ({brief(frame, 40)}) by the yaw of attitude0"
    return Companion(*attitude, sentence, _turned_from_ned if is_north_east_down(frame) else _turned)


def _with_accel(rows: Array, accel: Array) -> Array:
    return np.hstack([rows[:, _GYRO], accel[:, _ACCEL]])


def _turned(rows: Array, angles: Array) -> Array:
    return np.hstack([heading_axes(rows, angles[:, 2]), rows[:, 2:]])


def _turned_from_ned(rows: Array, angles: Array) -> Array:
    return _turned(np.column_stack([rows[:, 1], rows[:, 0], -rows[:, 2]]), angles)


def _other_half(bag: OpenBag, topic: str, has: str, lacks: str) -> str:
    """Return the topic of the other half of an IMU, by its name; empty for an IMU that is whole."""
    other = topic.replace(has, lacks)
    first = bag.first.get(topic)
    if has not in topic or first is None or other not in bag.first:
        return ""
    half = first.linear_acceleration if lacks == "accel" else first.angular_velocity
    return "" if any(np.nan_to_num([half.x, half.y, half.z])) else other


def _is_accelerometer(bag: OpenBag, topic: str) -> bool:
    """Return whether an IMU is a half with accelerometer only, by its name and its first message."""
    first, name = bag.first.get(topic), topic.lower()
    if first is None or "accel" not in name or "gyro" in name:
        return False
    turns = first.angular_velocity
    return not any(np.nan_to_num([turns.x, turns.y, turns.z]))


def _attitude(bag: OpenBag) -> tuple[str, RosRule] | None:
    """Return the topic that gives the attitude of the vehicle best, and its rule; None without one."""
    able = [
        (topic, rule)
        for rule in RULES
        if rule.stream == "attitude0"
        for topic, _, rows in bag.topics(rule.kind)
        if rows and gives_values(bag, rule, topic) and not doubt_of(bag, rule, topic)
    ]
    return min(able, key=lambda each: is_indirect(bag, each[1], each[0]), default=None)


def gives_values(bag: OpenBag, rule: RosRule, topic: str) -> bool:
    """Return whether a rule fits the version of the message, and an attitude is not left out in it."""
    first = bag.first.get(topic)
    if first is None:
        return not rule.needs
    return rule.fits(first) and (rule.stream != "attitude0" or bool(np.isfinite(rule.row(first)).any()))


def _frame(bag: OpenBag, rule: RosRule, topic: str) -> str:
    first = bag.first.get(topic)
    return rule.frame(first) if hasattr(first, "header") else ""


def is_indirect(bag: OpenBag, rule: RosRule, topic: str) -> bool:
    """Return whether the axes of the values are turned by another topic, or assumed to be the body's."""
    frame = _frame(bag, rule, topic)
    if rule.kind in (IMU, ODOMETRY):
        return bag.mount_of(topic) is None and not is_body(frame)
    return rule.stream == "velocity0" and is_world(frame)


def doubt_of(bag: OpenBag, rule: RosRule, topic: str) -> str:
    """Return the reason not to take a topic without a request; empty for none."""
    if not rule.is_certain(topic):
        return rule.doubt
    if rule.stream in _MEASUREMENTS and _COMMAND_WORDS & set(re.split(r"[^a-z]+", topic.lower())):
        return "by its name a command, no measurement"
    if rule.kind in RANGE_KINDS:
        return _doubt_of_range(bag, topic)
    frame = _frame(bag, rule, topic)
    if rule.kind in (IMU, ODOMETRY) and is_optical(frame) and bag.mount_of(topic) is None:
        return f"its frame {brief(frame, 40)!r} has the axes of a camera, and no transform to the body"
    if rule.stream == "imu0" and rule.kind == IMU and (gyro := _other_half(bag, topic, "accel", "gyro")):
        return f"it has no gyro, and is read with {gyro}"
    if rule.stream == "imu0" and rule.kind == IMU and _is_accelerometer(bag, topic):
        return "it has no gyro by its name, and its turns are 0"
    is_turned = rule.stream == "velocity0" and rule.kind != ODOMETRY and is_world(frame)
    if is_turned and _attitude(bag) is None:
        return f"in the world's axes ({brief(frame, 40)}), and there is no attitude to turn it by"
    return ""


def _doubt_of_range(bag: OpenBag, topic: str) -> str:
    mount = bag.mount_of(topic)
    if mount is None:
        is_aside = Look.of(topic, bag.frame_of(topic)) == Look.ASIDE
        return "by its name it does not look down" if is_aside else ""
    tilt = axis_tilt_deg(mount[:3, 0])
    return f"looks {tilt:.0f} degrees away from straight down" if tilt > MAX_TILT_DEG else ""
