"""ROS bags that are damaged, cut short or without index or metadata, and a missing reader."""

from __future__ import annotations

import math
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slam.core.errors import InputError
from slam.io.recordings.ros.bag_file import Bag
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import (
    ROS1,
    ROS2,
    Maker,
    a_flight,
    at,
    picture,
    ros1,
    without_index,
    write,
)

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
M = Maker(ROS1)
HALF = math.sqrt(0.5)


def test_a_bag_without_metadata_is_read(tmp_path):
    write(tmp_path / "bag", Maker(ROS2), a_flight(Maker(ROS2)))
    database = next((tmp_path / "bag").glob("*.db3"))
    shutil.copy(database, tmp_path / "alone.db3")
    assert len(read(tmp_path / "alone.db3").frames) == 5


@pytest.mark.parametrize("cut", [0.6, 0.95])
def test_an_mcap_file_that_is_cut_short_gives_its_complete_chunks(tmp_path, cut):
    """A recorder that is killed leaves no index. A chunk of a mebibyte holds two pictures here."""
    maker, messages = Maker(ROS2), []
    for k in range(8):
        header = maker.header(at(k), "base_link")
        messages += [
            ("/imu", at(k), maker.imu(header, (0.1 * k, 0.2, 0.3), (0.5, 0.25, 9.75))),
            ("/picture", at(k), maker.image(header, np.full((700, 1000), k, np.uint8), "mono8")),
        ]
    write(tmp_path / "bag", maker, messages, mcap=True)
    whole = next((tmp_path / "bag").glob("*.mcap"))
    content = whole.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: int(cut * len(content))])
    whole.write_bytes(path.read_bytes())
    flight = read(path)
    assert np.array_equal(read(tmp_path / "bag").imu.gyro_rad_s, flight.imu.gyro_rad_s)  # the folder alike
    count = len(flight.imu.stamps_s)
    assert 8 * cut - 2.5 < count < 8
    begin_ns, end_ns = Bag(path).span_ns
    assert begin_ns == at(0)
    assert at(count - 1) <= end_ns <= at(count)
    assert flight.imu.gyro_rad_s[:, 0] == pytest.approx(0.1 * np.arange(count))
    assert flight.imu.stamps_s == pytest.approx(0.01 * np.arange(count))
    assert any("the bag has no index (its recording was interrupted)" in line for line in flight.warnings)


@pytest.mark.parametrize("is_cut", [True, False])
def test_a_damaged_database_gives_the_messages_before_the_damage(tmp_path, is_cut):
    maker, messages = Maker(ROS2), []
    for k in range(40):
        header = maker.header(at(k), "base_link")
        messages += [
            ("/imu", at(k), maker.imu(header, (0.1 * k, 0.2, 0.3), (0.5, 0.25, 9.75))),
            ("/picture", at(k), maker.image(header, np.full((70, 100), k, np.uint8), "mono8")),
        ]
    write(tmp_path / "bag", maker, messages)
    database = next((tmp_path / "bag").glob("*.db3"))
    content = bytearray(database.read_bytes())
    middle = len(content) // 2
    if is_cut:
        del content[middle:]
    else:
        content[middle : middle + 40_000] = np.random.default_rng(0).bytes(40_000)
    database.write_bytes(content)
    flight = read(tmp_path / "bag")
    count = len(flight.imu.stamps_s)
    assert 12 < count < 22
    assert flight.imu.gyro_rad_s[:, 0] == pytest.approx(0.1 * np.arange(count))
    assert any("the bag is damaged after" in line for line in flight.warnings)
    shutil.copy(database, tmp_path / "alone.db3")
    assert len(read(tmp_path / "alone.db3").imu.stamps_s) == count


@pytest.mark.slow
@measured
def test_a_recorded_mcap_file_that_is_cut_short_gives_its_first_seconds(tmp_path):
    content = (SAMPLES / "mcap/hybrid12s/hybrid12s.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:1_200_000])
    complete, flight = read(SAMPLES / "mcap/hybrid12s/hybrid12s.mcap"), read(tmp_path / "cut.mcap")
    count = len(flight.imu.stamps_s)
    assert 800 < count < 1200
    assert np.array_equal(flight.imu.accel_m_s2, complete.imu.accel_m_s2[:count])
    assert any("its last 99,812 bytes are lost" in line for line in flight.warnings)


def outcome(path: Path) -> str:
    try:
        return "; ".join(read(path).warnings)
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_truncated_bag_is_one_line_or_a_warning(tmp_path, kind):
    path = write(tmp_path / "a.bag", Maker(ROS1), a_flight(Maker(ROS1)))
    if kind != "bag":
        write(tmp_path / "bag", Maker(ROS2), a_flight(Maker(ROS2)), mcap=kind == "mcap")
        path = next((tmp_path / "bag").glob(f"*.{kind}")).rename(tmp_path / f"a.{kind}")
    content = path.read_bytes()
    for share in (0.3, 0.7, 0.95):
        path.write_bytes(content[: int(share * len(content))])
        found = outcome(path)
        assert found
        assert "\n" not in found


def test_a_ros_1_bag_without_its_index_is_read(tmp_path):
    path = ros1(tmp_path / "a.bag", a_flight(M))
    expected, span_ns = read(path), Bag(path).span_ns
    flight = read(without_index(path))
    said = "the bag has no index (its recording was interrupted); end the next one before power is cut"
    assert flight.warnings == (said, *expected.warnings)
    assert np.array_equal(flight.imu.accel_m_s2, expected.imu.accel_m_s2)
    assert np.array_equal(flight.frames[3].read(), picture(3))
    assert Bag(path).span_ns == span_ns == (at(0), at(4) + 3_000_000)


def test_a_truncated_ros_1_bag_gives_its_whole_chunks(tmp_path):
    path = write(tmp_path / "a.bag", M, a_flight(M), chunk_bytes=500)
    whole = len(read(path).imu.stamps_s)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    flight = read(path)
    assert 0 < len(flight.imu.stamps_s) < whole
    assert any("has no index (its recording was interrupted)" in line for line in flight.warnings)


def test_a_type_of_another_version_is_left(tmp_path):
    """A recorder may define a type of its own under a name of ROS, with other fields."""
    store, name = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/Range"
    del store.fielddefs[name], store.types[name]
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 distance", name))
    other = Maker(store)
    messages = [("/range", at(0), other.make(name, header=other.header(at(0), "sonar"), distance=1.0))]
    still = (0.0, 0.0, 0.0)
    messages += [("/imu", at(k), other.imu(other.header(at(k), "imu"), still, still)) for k in range(3)]
    flight = read(write(tmp_path / "bag", other, messages, mcap=True))
    assert flight.sonar is None
    assert flight.imu is not None


def test_a_missing_reader_is_one_line_with_the_command(tmp_path, monkeypatch):
    path = ros1(tmp_path / "a.bag", a_flight(M))
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(
        InputError, match=r"rosbags .* not installed; run: pip install 'lemniscate-slam\[ros\]'"
    ):
        read(path)
