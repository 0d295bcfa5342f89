"""A growing map in an MCAP file."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from slam.io.exports.foxglove.foxglove_file import new_mcap
from slam.io.exports.foxglove.live_map import LiveMap
from slam.io.recordings.mcap_file import McapFile
from tests.slam.io.exports.made_map import CAMERA, pose

NONE = np.zeros((0, 2), np.int64)


def state(placed: list[bool], kept=NONE, rejected=NONE) -> tuple:
    """Frames, stamps, poses and links: keyframe k is k m to the east, at k s, of frame 10 k."""
    k = np.arange(len(placed))
    w_T_b = np.array([pose((float(n), 0.0, 10.0)) if placed[n] else np.full((4, 4), np.nan) for n in k])
    return (
        10 * k,
        k * 10**9,
        w_T_b.reshape(-1, 4, 4),
        {"neighbours": NONE, "kept": kept, "contradicted": rejected},
    )


def picture(frame: int) -> np.ndarray | None:
    """Noise, which JPEG cannot make smaller than path and links; that of frame 10 cannot be read."""
    return None if frame == 10 else np.random.default_rng(frame).integers(0, 255, (48, 64), np.uint8)


def found(path, topic) -> list:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(m.log_time, d) for _, _, m, d in reader.iter_decoded_messages([topic])]


@pytest.fixture
def path(tmp_path):
    """Keyframe 1 is placed after 2, by a loop."""
    with new_mcap(tmp_path / "live.mcap", {}) as file:
        grown = LiveMap(file, CAMERA, picture)
        grown.update(*state([]))
        grown.update(*state([True]))
        grown.update(*state([True, False, True]))
        grown.update(*state([True, False, True]))
        both = np.array([[0, 1]]), np.array([[0, 2], [1, 2]])
        grown.update(*state([True, True, True], *both), is_end=True)
    return tmp_path / "live.mcap"


def test_each_keyframe_is_written_once_when_it_is_placed(path):
    poses = found(path, "/slam/pose")
    assert [message.pose.position.x for _, message in poses] == [0.0, 2.0, 1.0]
    assert [message.timestamp.ToSeconds() for _, message in poses] == [0, 2, 1]
    assert [stamp_ns for stamp_ns, _ in poses] == [0, 2 * 10**9, 2 * 10**9], "when it was known"
    assert [message.timestamp.ToSeconds() for _, message in found(path, "/camera/image")] == [0, 2]
    assert len(found(path, "/tf_static")) == 1


def test_path_and_links_are_written_with_new_keyframes(path):
    assert [len(message.poses) for _, message in found(path, "/slam/path")] == [1, 2, 3]
    *_, (_, scene) = found(path, "/slam/links")
    ends = {entity.id: [p.x for p in entity.lines[0].points] for entity in scene.entities}
    assert ends == {"neighbours": [], "kept": [0, 1], "contradicted": [0, 2, 1, 2]}


def grow(path, count: int, **options) -> None:
    with new_mcap(path, {}, **options) as file:
        grown = LiveMap(file, CAMERA, picture)
        for n in range(1, count + 1):
            grown.update(*state([True] * n))


def test_whole_messages_take_a_share_of_the_pictures(tmp_path):
    """Written with each keyframe, the paths would take twice the pictures here."""
    grow(tmp_path / "live.mcap", 80)
    whole, pictures = (
        sum(message.ByteSize() for topic in topics for _, message in found(tmp_path / "live.mcap", topic))
        for topics in (("/slam/path", "/slam/links"), ("/camera/image",))
    )
    assert 0.2 * pictures < whole < 0.4 * pictures


def test_what_was_written_before_a_crash_can_be_read(tmp_path):
    grow(tmp_path / "live.mcap", 20, chunk_bytes=4096)
    content = (tmp_path / "live.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    read = McapFile(tmp_path / "cut.mcap")
    assert not read.has_end
    poses = next(channel for channel in read.channels.values() if channel.topic == "/slam/pose")
    assert 5 < len(poses.times_ns) < 15
