"""MCAP with Foxglove's schemas in JSON and protobuf: values worked out by hand, mounts, and damage."""

from __future__ import annotations

import base64
from collections import Counter

import cv2
import lz4.frame
import numpy as np
import pytest
from backports import zstd

from frontend.camera import NADIR_B_T_C
from slam.core.errors import InputError
from slam.io.recordings.foxglove.protobuf import ProtobufTypes
from tests.slam.io.recordings.foxglove.made_mcap import (
    BYTES,
    DOUBLE,
    FIXED32,
    MESSAGE,
    STRING,
    TIMESTAMP,
    channel,
    chunk,
    declared_field,
    declared_file,
    declared_type,
    delimited,
    double,
    fixed32,
    integer,
    json_records,
    mcap,
    message,
    schema,
    varint,
)
from tests.slam.io.recordings.read_recording import read

START_S = 1_700_000_000
START_NS = START_S * 10**9
PIXELS = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
CALIBRATION = {
    "width": 6,
    "height": 4,
    "distortion_model": "plumb_bob",
    "K": [5.0, 0, 2.5, 0, 6.0, 1.5, 0, 0, 1],
    "D": [0.1, 0.02, 0.001, 0.002, 0.0],
}


def png() -> bytes:
    return cv2.imencode(".png", PIXELS)[1].tobytes()


def stamp(seconds: int = 0, nanoseconds: int = 0) -> dict:
    return {"sec": START_S + seconds, "nsec": nanoseconds}


def transform(parent: str, child: str, xyz: tuple, xyzw: tuple, seconds: int = 0) -> dict:
    return {
        "timestamp": stamp(seconds),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": dict(zip("xyz", xyz, strict=True)),
        "rotation": dict(zip("xyzw", xyzw, strict=True)),
    }


def picture(seconds: int) -> dict:
    data = base64.b64encode(png()).decode()
    return {"timestamp": stamp(seconds, 250), "frame_id": "cam", "format": "png", "data": data}


def a_flight() -> list[tuple]:
    """Three pictures and two fixes; the camera is 0.1 m ahead of the body, which moves, and looks down."""
    down = (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0)
    rows = [("/calibration", "CameraCalibration", START_NS, {"frame_id": "cam", **CALIBRATION})]
    for k in range(3):
        time_ns = START_NS + k * 10**9 + 10**6
        rows.append(("/camera", "CompressedImage", time_ns, picture(k)))
        mount = transform("base_link", "cam", (0.1, 0, 0), down, k)
        moving = transform("map", "base_link", (k, 0, 1), (0, 0, 0, 1), k)
        rows.append(("/tf", "FrameTransforms", time_ns, {"transforms": [mount, moving]}))
    for k, latitude in enumerate((50.5, 0.0)):
        fix = {"timestamp": stamp(k), "latitude": latitude, "longitude": latitude / 10, "altitude": 99.5}
        rows.append(("/fix", "LocationFix", START_NS + k, fix))
    return rows


@pytest.mark.parametrize("compression", ["", "lz4", "zstd", "none"])
def test_a_flight_in_json(compression, tmp_path):
    records = b"".join(json_records(a_flight()))
    packed = {"": records, "lz4": lz4.frame.compress(records), "zstd": zstd.compress(records)}
    parts = [records] if compression == "none" else [chunk(records, compression, packed[compression])]
    flight = read(mcap(tmp_path / "a.mcap", *parts))
    assert flight.camera.focal_px == (5.0, 6.0)
    assert flight.camera.center_px == (2.5, 1.5)
    assert flight.camera.distortion == (0.1, 0.02, 0.001, 0.002, 0.0)
    expected = NADIR_B_T_C.copy()
    expected[0, 3] = 0.1
    np.testing.assert_allclose(flight.camera.b_T_c, expected, atol=1e-12)
    assert len(flight.frames) == 3
    for k in (2, 0, 1):
        assert np.array_equal(flight.frames.load(k), PIXELS)
    np.testing.assert_allclose(
        flight.frames.stamps_s + flight.epoch_ns / 1e9, START_S + np.arange(3) + 250e-9
    )
    assert flight.gps.latitude_deg.tolist() == [50.5]
    assert flight.gps.altitude_m.tolist() == [99.5]


def test_a_camera_without_a_fixed_transform_is_assumed_to_look_down(tmp_path):
    rows = [row for row in a_flight() if row[1] != "FrameTransforms"]
    flight = read(mcap(tmp_path / "a.mcap", *json_records(rows)))
    np.testing.assert_allclose(flight.camera.b_T_c, NADIR_B_T_C)
    assert any("looking straight down" in line for line in flight.warnings)


def test_raw_pictures_and_poses(tmp_path):
    raw = {
        "timestamp": stamp(),
        "frame_id": "cam",
        "width": 6,
        "height": 4,
        "encoding": "rgb8",
        "step": 18,
        "data": base64.b64encode(np.ascontiguousarray(PIXELS[..., ::-1]).tobytes()).decode(),
    }
    half = float(np.sqrt(0.5))
    pose = {
        "timestamp": stamp(),
        "frame_id": "map",
        "pose": {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": half, "w": half}},
    }
    rows = [
        ("/camera/raw", "RawImage", START_NS, raw),
        ("/camera/camera_info", "CameraCalibration", START_NS, {"frame_id": "", **CALIBRATION}),
        ("/vicon/drone", "PoseInFrame", START_NS, pose),
    ]
    flight = read(mcap(tmp_path / "a.mcap", *json_records(rows)))
    assert np.array_equal(flight.frames.load(0), PIXELS)
    np.testing.assert_allclose(flight.truth.w_T_b[0, :3, 3], [1, 2, 3])
    np.testing.assert_allclose(flight.truth.w_T_b[0, :3, 0], [0, 1, 0], atol=1e-12)


def protobuf_schema() -> bytes:
    stamped = declared_field("timestamp", 1, MESSAGE, ".google.protobuf.Timestamp")
    return TIMESTAMP + declared_file(
        "foxglove",
        declared_type(
            "CompressedImage",
            stamped,
            declared_field("frame_id", 4, STRING),
            declared_field("data", 2, BYTES),
            declared_field("format", 3, STRING),
        ),
        declared_type(
            "CameraCalibration",
            stamped,
            declared_field("frame_id", 9, STRING),
            declared_field("width", 2, FIXED32),
            declared_field("height", 3, FIXED32),
            declared_field("distortion_model", 4, STRING),
            declared_field("D", 5, DOUBLE, repeated=True),
            declared_field("K", 6, DOUBLE, repeated=True),
        ),
    )


def test_a_flight_in_protobuf(tmp_path):
    time = delimited(1, integer(1, START_S) + integer(2, 500))
    k = b"".join(np.float64(value).tobytes() for value in CALIBRATION["K"])
    d = b"".join(double(5, value) for value in CALIBRATION["D"])
    calibration = time + fixed32(2, 6) + fixed32(3, 4) + delimited(4, b"plumb_bob") + d + delimited(6, k)
    image = time + delimited(4, b"cam") + delimited(3, b"png") + delimited(2, png()) + integer(99, 1)
    records = [
        schema(1, "foxglove.CompressedImage", "protobuf", protobuf_schema()),
        schema(2, "foxglove.CameraCalibration", "protobuf", protobuf_schema()),
        channel(1, 1, "/camera", "protobuf"),
        channel(2, 2, "/calibration", "protobuf"),
        message(2, START_NS, calibration),
        message(1, START_NS, image),
    ]
    flight = read(mcap(tmp_path / "a.mcap", *records))
    assert flight.camera.focal_px == (5.0, 6.0)
    assert flight.camera.distortion == (0.1, 0.02, 0.001, 0.002, 0.0)
    assert flight.epoch_ns == START_NS + 500
    assert np.array_equal(flight.frames.load(0), PIXELS)


def test_numbers_of_protobuf():
    """150 is the example of the encoding's documentation: 08 96 01."""
    kinds = {"int32": 5, "sint32": 17, "bool": 8, "sfixed32": 15, "float": 2}
    fields = [declared_field(name, number, kind) for number, (name, kind) in enumerate(kinds.items(), 1)]
    numbers = declared_field("many", 6, 5, repeated=True)
    types = ProtobufTypes(declared_file("t", declared_type("T", *fields, numbers)))
    assert types.decode("t.T", bytes.fromhex("089601"))["int32"] == 150
    assert types.decode("t.T", integer(1, -2))["int32"] == -2
    assert types.decode("t.T", integer(2, 3))["sint32"] == -2
    assert types.decode("t.T", integer(3, 1))["bool"] is True
    assert types.decode("t.T", fixed32(4, 2**32 - 5))["sfixed32"] == -5
    assert types.decode("t.T", varint(5 << 3 | 5) + np.float32(1.5).tobytes())["float"] == 1.5
    packed = types.decode("t.T", delimited(6, bytes.fromhex("038e029ea705")) + integer(6, 7))
    assert packed["many"] == [3, 270, 86942, 7], "packed and single values of one field"
    assert types.decode("t.T", b"") == {**dict.fromkeys(kinds, 0), "many": []}


def test_channels_that_no_stream_takes_are_named(tmp_path):
    rows = [*a_flight(), ("/log", "Log", START_NS, {"message": "hello"})]
    flight = read(mcap(tmp_path / "a.mcap", *json_records(rows)))
    assert "/log" in {source.channel for source in flight.sources if not source.stream}


def test_a_file_that_is_cut_short_gives_what_comes_before(tmp_path):
    whole = mcap(tmp_path / "a.mcap", *json_records(a_flight())).read_bytes()
    (tmp_path / "b.mcap").write_bytes(whole[:-400])
    flight = read(tmp_path / "b.mcap")
    assert len(flight.frames) == 3
    assert any("bytes are damaged or cut short" in line for line in flight.warnings)


def test_a_damaged_chunk_is_passed_over(tmp_path):
    first, second = chunk(b"".join(json_records(a_flight()))), chunk(message(1, START_NS + 5, b"{}"))
    damaged = bytearray(second)
    damaged[-1] ^= 0xFF
    flight = read(mcap(tmp_path / "a.mcap", first, bytes(damaged)))
    assert len(flight.frames) == 3
    assert any("bytes are damaged" in line for line in flight.warnings)


@pytest.mark.parametrize("data", [b"", b"\x07", b"\xff" * 40, b"[1]", b'{"data": 3}', b'{"transforms": 5}'])
@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_damaged_messages_and_schemas_end_in_one_line(data, encoding, tmp_path):
    for name in ("CompressedImage", "FrameTransforms", "CameraCalibration"):
        for description in (protobuf_schema(), data):
            records = [
                schema(1, f"foxglove.{name}", "protobuf", description),
                channel(1, 1, "/a", encoding),
                message(1, START_NS, data),
            ]
            with pytest.raises(InputError) as refused:
                read(mcap(tmp_path / "a.mcap", *records))
            assert "\n" not in str(refused.value)


def test_a_file_that_ends_between_two_records_says_so(tmp_path):
    """Nothing of it is damaged; only the record of the end is missing."""
    whole = mcap(tmp_path / "a.mcap", *json_records(a_flight()))
    assert not any("without the record of its end" in line for line in read(whole).warnings)
    begin, end = b"\x89MCAP0\r\n", b"\x0f" + (4).to_bytes(8, "little")
    content = whole.read_bytes()
    (tmp_path / "b.mcap").write_bytes(content[: content.index(end, len(begin))])
    assert any("without the record of its end" in line for line in read(tmp_path / "b.mcap").warnings)


def read_damaged(path) -> tuple[object, str]:
    """The flight or None, and the text of the refusal or the warnings."""
    try:
        flight = read(path)
    except InputError as refused:
        return None, str(refused)
    return flight, "; ".join(flight.warnings)


@pytest.mark.parametrize("seed", [4])
def test_random_damage_changes_no_value_and_is_named(seed, tmp_path):
    """Each record has a chunk with a checksum: what is read is what was written, and losses are named."""
    whole = mcap(tmp_path / "a.mcap", *map(chunk, json_records(a_flight()))).read_bytes()
    rng, outcomes = np.random.default_rng(seed), Counter()
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(50, len(whole), rng.integers(1, 3)):
            damaged[place] = rng.integers(256)
        (tmp_path / "b.mcap").write_bytes(damaged[: rng.integers(len(whole) // 2, 2 * len(whole))])
        flight, said = read_damaged(tmp_path / "b.mcap")
        if flight is None:
            assert "b.mcap: " in said
            assert "\n" not in said
            outcomes["refused"] += 1
            continue
        pictures = 0 if flight.frames is None else len(flight.frames)
        assert all(np.array_equal(flight.frames.load(k), PIXELS) for k in range(pictures))
        assert flight.gps is None or set(flight.gps.latitude_deg.tolist()) <= {50.5}
        is_whole = pictures == 3 and flight.gps is not None
        assert is_whole or "bytes are damaged" in said or "record of its end" in said
        outcomes["whole" if is_whole else "in part"] += 1
    assert {*outcomes} == {"refused", "in part", "whole"}, "the damage is of every degree"
