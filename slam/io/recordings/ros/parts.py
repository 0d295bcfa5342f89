"""ROS 1 bags that are the parts of one recording (``rosbag record --split``)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from slam.io.recordings.ros.bag_file import DESCRIPTION, Bag
from slam.io.recordings.ros.rosbag import recording_of

_LONGEST_PAUSE_NS = 10 * 10**9
"""A recorder that opens the next file loses seconds at most, even on a slow disk."""


def parts_in_order(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Return the bags in the order of time if they are parts of one recording, else nothing.

    Parts follow each other without overlap, and hold the same channels. Raises ``InputError`` for a damaged
    bag.
    """
    bags = sorted((Bag(path) for path in paths), key=lambda bag: bag.span_ns)
    for bag, following in pairwise(bags):
        pause_ns = following.span_ns[0] - bag.span_ns[1]
        used = {offer.channel for offer in recording_of(bag, DESCRIPTION).offers}
        if not 0 <= pause_ns <= _LONGEST_PAUSE_NS or not used & {c.topic for c in following.connections}:
            return ()
    return tuple(bag.path for bag in bags)
