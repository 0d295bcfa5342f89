"""Whole recordings for the fuzzer: what writes each, what reads it, and the readings in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slam.cli.source import open_flight
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.io.flight_folder import write_flight
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording
from slam.io.recordings.video.gpmf import read_gopro
from slam.io.recordings.video.mp4 import read_tracks
from tests.slam.io.made_flight import made_flight
from tests.slam.io.recordings.foxglove.made_mcap import chunk, json_records, mcap
from tests.slam.io.recordings.foxglove.test_foxglove import a_flight
from tests.slam.io.recordings.logs import made_ulog, test_ardrone, test_dataflash, test_tlog
from tests.slam.io.recordings.ros import made_bag
from tests.slam.io.recordings.test_archive import files_of, zipped
from tests.slam.io.recordings.test_tum import folder as tum_folder
from tests.slam.io.recordings.video.made_video import file_of_samples, video
from tests.slam.io.recordings.video.test_gpmf import gps5

SECONDS = 2.0
"""Length of the flight in the archive."""


@dataclass(frozen=True)
class Recorded:
    """A recording: ``write`` writes it into a folder and returns the file to mutate."""

    write: Callable[[Path], Path]
    rows: dict[str, int]
    """Number of readings of each stream of the whole recording."""
    read: Callable[[Path], Flight] = lambda path: flight_of(open_recording(path))


def _telemetry(folder: Path) -> Path:
    packets = [test_tlog.at(k / 10, test_tlog.attitude(k / 10, 0.1, 0.2, 0.3)) for k in range(1, 6)]
    return test_tlog.log(folder / "a.tlog", *packets)


def _navdata(folder: Path) -> Path:
    path = folder / "a.navdata"
    packets = [
        test_ardrone.packet(test_ardrone.time(5 + k), test_ardrone.demo(1000, 500, 9000, 1250), number=k + 1)
        for k in range(4)
    ]
    path.write_bytes(b"".join(packets))
    return path


def _ardupilot(folder: Path) -> Path:
    return test_dataflash.log(folder / "a.bin", {"IMU": (*test_dataflash.IMU, test_dataflash.imu_rows())})


def _px4(folder: Path) -> Path:
    rows = [(4000 * k, 0.1, 0.2, 0.3, 4000, 1.0, 2.0, -9.8, 4000) for k in range(1, 6)]
    layout = (
        "float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2;"
        "uint32_t accelerometer_integral_dt;"
    )
    return made_ulog.log(folder / "a.ulg", {"sensor_combined": (layout, "3fI3fI", rows)})


def _foxglove(folder: Path) -> Path:
    return mcap(folder / "a.mcap", *map(chunk, json_records(a_flight())))


def _ros_1(folder: Path) -> Path:
    return made_bag.ros1(folder / "a.bag", made_bag.a_flight(made_bag.Maker(made_bag.ROS1)))


def _ros_2(folder: Path, kind: str) -> Path:
    maker = made_bag.Maker(made_bag.ROS2)
    bag = made_bag.write(folder / "bag", maker, made_bag.a_flight(maker), mcap=kind == "mcap")
    return next(bag.glob(f"*.{kind}"))


def _tum(folder: Path) -> Path:
    row = " ".join(map(str, (1.5, 2.5, 3.5, 0.7, -0.7, 0.0, 0.0)))
    root = tum_folder(folder / "tum", f"1305031102.1753 {row}\n1305031102.2753 {row}\n")
    return root / "groundtruth.txt"


def _archive(folder: Path) -> Path:
    write_flight(made_flight(seconds=SECONDS), folder / "flight")
    return zipped(folder / "a.zip", files_of(folder / "flight"))


def gopro(folder: Path) -> Path:
    """Write a video without pictures that holds the positions of a GoPro."""
    row = (475_000_000, 82_500_000, 488_250, 0, 0)
    return file_of_samples(
        folder / "a.mp4", b"meta", b"gpmd", [1000, 1000], [gps5(3, row, row), gps5(2, row)]
    )


def gopro_positions(path: Path) -> int:
    """Return the number of positions of a GoPro in the first track of a video; 0 without any."""
    tracks = read_tracks(path)
    found = read_gopro(path, tracks[0]) if tracks else None
    return 0 if found is None else len(found.positions.stamps_ns)


RECORDINGS = {
    "MAVLink telemetry": Recorded(_telemetry, {"attitude": 5}),
    "navdata": Recorded(_navdata, {"attitude": 4, "velocity": 4, "sonar": 4}),
    "ArduPilot log": Recorded(_ardupilot, {"imu": 5}),
    "PX4 log": Recorded(_px4, {"imu": 5}),
    "Foxglove MCAP": Recorded(_foxglove, {"frames": 3, "gps": 1}),
    "ROS 1 bag": Recorded(_ros_1, {"frames": 5, "imu": 5, "sonar": 5}),
    "ROS 2 database": Recorded(lambda folder: _ros_2(folder, "db3"), {"frames": 5, "imu": 5, "sonar": 5}),
    "ROS 2 MCAP": Recorded(lambda folder: _ros_2(folder, "mcap"), {"frames": 5, "imu": 5, "sonar": 5}),
    "TUM": Recorded(_tum, {"frames": 2, "truth": 2}, lambda path: flight_of(open_recording(path.parent))),
    "video": Recorded(lambda folder: video(folder / "a.mp4", 5), {"frames": 5}),
    "archive": Recorded(_archive, {}, lambda path: open_flight(path, silent)[0]),
}
