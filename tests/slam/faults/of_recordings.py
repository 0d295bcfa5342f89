"""Faults 8 to 14 of recordings: bags without index or metadata, lying lengths, and damaged videos."""

from __future__ import annotations

from pathlib import Path

from tests.slam.faults.fault import Fault
from tests.slam.io.recordings.ros.made_bag import ROS1, ROS2, Maker, a_flight, without_index, write
from tests.slam.io.recordings.video.made_video import video, zero_pictures


def bag_without_metadata(place: Path) -> Path:
    """The database of a ROS 2 bag alone in its folder."""
    bag = write(place / "bag", Maker(ROS2), a_flight(Maker(ROS2)))
    (bag / "metadata.yaml").unlink()
    return next(bag.glob("*.db3"))


def unindexed_bag(place: Path) -> Path:
    """A ROS 1 bag whose recorder died."""
    return without_index(write(place / "a.bag", Maker(ROS1), a_flight(Maker(ROS1))))


def lying_length(place: Path) -> Path:
    """An MCAP whose first record says that it is larger than any disk."""
    bag = write(place / "bag", Maker(ROS2), a_flight(Maker(ROS2)), mcap=True)
    path = next(bag.glob("*.mcap")).rename(place / "a.mcap")
    content = bytearray(path.read_bytes())
    content[9:17] = (1 << 62).to_bytes(8, "little")
    path.write_bytes(bytes(content))
    return path


def video_without_index(place: Path) -> Path:
    path = video(place / "a.mp4")
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"moov") - 4])
    return path


def damaged_middle(place: Path) -> Path:
    """A video with two pictures of zero bytes."""
    path = video(place / "a.mp4")
    zero_pictures(path, (20, 21))
    return path


FAULTS = (
    Fault(8, "ROS 2 bag without metadata", "W", "cam0", bag_without_metadata, "import", "graph"),
    Fault(9, "unindexed ROS 1 bag", "W", "index", unindexed_bag, "import", "graph"),
    Fault(10, "MCAP with a lying length", "E", "a length in it is damaged", lying_length, "import", "graph"),
    Fault(13, "MP4 without its index", "E", "moov", video_without_index, "import", "graph"),
    Fault(14, "damage in mid-video", "W", "damaged|unreadable|missing", damaged_middle, "import", "graph"),
)
