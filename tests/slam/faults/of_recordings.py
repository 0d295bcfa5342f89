"""Faults 8 to 14 of recordings: bags without index or metadata, lying lengths, and damaged videos."""

from __future__ import annotations

from pathlib import Path

from slam.io.recordings.mp4 import read_tracks
from tests.slam.faults.fault import Fault
from tests.slam.io.recordings.made_bag import ROS1, ROS2, Maker, write
from tests.slam.io.recordings.made_video import video
from tests.slam.io.recordings.test_rosbag import a_flight


def bag_without_metadata(place: Path) -> Path:
    """The database of a ROS 2 bag alone in its folder."""
    bag = write(place / "bag", Maker(ROS2), a_flight(Maker(ROS2)))
    (bag / "metadata.yaml").unlink()
    return next(bag.glob("*.db3"))


def unindexed_bag(place: Path) -> Path:
    """A ROS 1 bag whose recorder died: no index, and its place in the header is 0."""
    path = write(place / "a.bag", Maker(ROS1), a_flight(Maker(ROS1)))
    content = bytearray(path.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(content[at : at + 8], "little")
    content[at : at + 8] = bytes(8)
    path.write_bytes(bytes(content[:end]))
    return path


def lying_length(place: Path) -> Path:
    """An MCAP whose first record says that it is larger than any disk."""
    bag = write(place / "bag", Maker(ROS2), a_flight(Maker(ROS2)), mcap=True)
    path = next(bag.glob("*.mcap")).rename(place / "a.mcap")
    content = bytearray(path.read_bytes())
    content[9:17] = (1 << 62).to_bytes(8, "little")
    path.write_bytes(bytes(content))
    return path


def without_index(place: Path) -> Path:
    path = video(place / "a.mp4")
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"moov") - 4])
    return path


def damaged_middle(place: Path) -> Path:
    """A video with two pictures of zero bytes."""
    path = video(place / "a.mp4")
    track = read_tracks(path)[0]
    content = bytearray(path.read_bytes())
    for k in (20, 21):
        at, size = int(track.offsets[k]), int(track.sizes[k])
        content[at : at + size] = bytes(size)
    path.write_bytes(bytes(content))
    return path


FAULTS = (
    Fault(8, "ROS 2 bag without metadata", "W", "cam0", bag_without_metadata, "import", "graph"),
    Fault(9, "unindexed ROS 1 bag", "W", "index", unindexed_bag, "import", "graph"),
    Fault(10, "MCAP with a lying length", "E", "a length in it is damaged", lying_length, "import", "graph"),
    Fault(13, "MP4 without its index", "E", "moov", without_index, "import", "graph"),
    Fault(14, "damage in mid-video", "W", "damaged|unreadable|missing", damaged_middle, "import", "graph"),
)
