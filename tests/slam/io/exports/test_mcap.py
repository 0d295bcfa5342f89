"""The MCAP file of a map, read by the mcap package and by our own reader of recordings."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from backend.measurements import LinkCheck, Rejection, RelativePose
from frontend.camera import Camera
from slam.core.errors import InputError
from slam.core.estimate import LoopVerdict
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin
from slam.core.messages import about, reason
from slam.core.streams import Frames
from slam.io.exports.formats import export_map
from slam.io.geotiff import Block, Grid, write_bands, write_geotiff
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording
from tests.slam.io.exports.made_map import FIRST_NS, exported, made_map, pose

HALF = np.sqrt(0.5)
AT = ((1.0, 2.0, 10.0), (3.0, 4.0, 11.0))
WIDE = Camera((2000.0, 2000.0), (1279.5, 959.5), (2560, 1920), (0.1, -0.05, 0.01, 0.0))
COVARIANCES = np.tile(np.diag([0.01, 0, 0, 1, 4, 9]), (2, 1, 1))


def edge(kind):
    return RelativePose(0, 1, np.eye(4), np.eye(6), kind)


def flight(camera=WIDE, names=("P0.jpg", "P1.jpg")) -> Flight:
    """Grey pictures with a white square; the second cannot be read."""
    picture = np.full(camera.size_px[::-1], 90, np.uint8)
    picture[100:300, 100:500] = 255
    return Flight(
        "made", camera=camera, frames=Frames(np.arange(2.0), names, lambda k: None if k else picture)
    )


def rasters(folder: Path, grid: Grid) -> Path:
    """A mosaic, red in the west and blue in the east, whose first row was not seen, over a ramp."""
    rgba = np.zeros((grid.height, grid.width, 4), np.uint8)
    rgba[1:, :, 3], rgba[:, : grid.width // 2, 0], rgba[:, grid.width // 2 :, 2] = 255, 200, 100
    write_geotiff(folder / "mosaic.tif", grid, iter([Block(0, 0, rgba)]))
    ramp = np.tile(np.arange(grid.width, dtype=np.float32), (grid.height, 1))
    write_bands(folder / "elevation.tif", grid, {"height": ramp, "std": ramp, "source": ramp})
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A map with everything."""
    folder = tmp_path_factory.mktemp("map")
    rejected = LoopVerdict(0, 1, Rejection(LinkCheck.GRAPH, "7 sigma"))
    estimate = made_map(
        *map(pose, AT),
        covariances=COVARIANCES,
        camera=WIDE,
        relative_poses=(edge("odometry"), edge("loop")),
        loops=(rejected,),
        messages=(reason("scale rests on GPS"), about("cam0", "1 picture lost")),
        floor_z_m=-0.5,
    )
    rasters(folder, Grid(-4.0, 6.0, 1.0, 8, 6))
    target = folder / "map.mcap"
    notes = export_map(exported(estimate, folder=folder, flight=flight()), "mcap", target)
    assert notes == (
        "the map's status is: scale rests on GPS",
        "pictures that cannot be read are left out: P1.jpg",
    )
    return target


def messages(path: Path, topic: str) -> list:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(m.log_time, d) for _, _, m, d in reader.iter_decoded_messages([topic])]


def test_checksums_index_and_statistics_agree_with_the_messages(whole):
    with whole.open("rb") as file:
        straight = [(c.topic, s.name, m.log_time) for s, c, m in NonSeekingReader(file, True).iter_messages()]
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        by_index, summary = (
            [(c.topic, s.name, m.log_time) for s, c, m in reader.iter_messages()],
            reader.get_summary(),
        )
        (facts,) = reader.iter_metadata()
    assert sorted(straight) == sorted(by_index)
    assert summary.statistics.message_count == len(straight) == 17
    assert summary.statistics.message_start_time == FIRST_NS
    assert summary.statistics.message_end_time == FIRST_NS + 10**9
    assert all(channel.schema_id in summary.schemas for channel in summary.channels.values())
    assert {schema.encoding for schema in summary.schemas.values()} == {"protobuf"}
    assert all(name.startswith("foxglove.") for _, name, _ in straight)
    assert (facts.metadata["status"], facts.metadata["unit"]) == ("scale rests on GPS", "m")


def test_poses_have_the_covariance_of_fixed_axes(whole):
    """The nose points to the north: forward is the world's y, and left its -x."""
    (first_ns, first), (second_ns, second) = messages(whole, "/slam/odometry")
    assert (first_ns, second_ns) == (FIRST_NS, FIRST_NS + 10**9)
    assert first.timestamp.ToNanoseconds() == FIRST_NS
    assert (first.frame_id, first.body_frame_id) == ("map", "base_link")
    at, q = second.pose.position, first.pose.orientation
    assert (at.x, at.y, at.z) == AT[1]
    np.testing.assert_allclose((q.x, q.y, q.z, q.w), (0, 0, HALF, HALF), atol=1e-12)
    covariance = np.reshape(first.pose_covariance, (6, 6))
    np.testing.assert_allclose(covariance, np.diag([4.0, 1, 9, 0, 0.01, 0]), atol=1e-12)
    assert {pair.key: pair.value for pair in first.metadata} == {"picture": "P0.jpg", "part": "0"}
    ((_, path),) = messages(whole, "/slam/path")
    assert [p.position.x for p in path.poses] == [1.0, 3.0]


def test_frames_form_a_tree_from_the_map_to_the_camera(whole):
    ((_, static),) = messages(whole, "/tf_static")
    (mount,) = static.transforms
    assert (mount.parent_frame_id, mount.child_frame_id) == ("base_link", "camera_optical_frame")
    q = mount.rotation
    # The camera looks down with its x to the right: half a turn about the axis (1, -1, 0).
    np.testing.assert_allclose(np.abs((q.x, q.y, q.z, q.w)), (HALF, HALF, 0, 0), atol=1e-12)
    assert q.x * q.y < 0
    moving = [message.transforms[0] for _, message in messages(whole, "/tf")]
    assert [(t.parent_frame_id, t.child_frame_id) for t in moving] == [("map", "base_link")] * 2
    assert [t.translation.z for t in moving] == [10.0, 11.0]


def test_pictures_are_reduced_with_their_camera(whole):
    """The white square is between 50 and 150, and 50 and 250 pixels, of a picture of half the size."""
    ((stamp_ns, image),) = messages(whole, "/camera/image")
    ((_, camera),) = messages(whole, "/camera/calibration")
    picture = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert (stamp_ns, image.format, image.frame_id) == (FIRST_NS, "jpeg", "camera_optical_frame")
    assert picture.shape == (960, 1280) == (camera.height, camera.width)
    rows, cols = np.nonzero(picture > 200)
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (50, 149, 50, 249)
    np.testing.assert_allclose(np.reshape(camera.K, (3, 3)), [[1000, 0, 639.5], [0, 1000, 479.5], [0, 0, 1]])
    assert list(camera.D) == [0.1, -0.05, 0.01, 0.0, 0.0]


def test_ground_has_the_mosaic_s_colours_at_the_surface_s_heights(whole):
    ((_, cloud),) = messages(whole, "/slam/floor")
    kind = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])
    points = np.frombuffer(cloud.data, kind)
    assert cloud.point_stride == kind.itemsize
    assert [(field.name, field.offset) for field in cloud.fields][3:] == [
        ("red", 12), ("green", 13), ("blue", 14), ("alpha", 15)
    ]  # fmt: skip
    x, y, z = points["xyz"].T
    assert len(points) == 8 * 5
    assert (x.min(), x.max(), y.min(), y.max()) == (-3.5, 3.5, 0.5, 4.5)
    np.testing.assert_allclose(z, x + 3.5 - 0.5)
    np.testing.assert_array_equal(points["rgba"][:, 0], np.where(x < 0, 200, 0))
    np.testing.assert_array_equal(points["rgba"][:, 2], np.where(x < 0, 0, 100))


def test_links_have_the_colour_and_the_reason_of_their_verdict(whole):
    ((_, scene),) = messages(whole, "/slam/links")
    found = {entity.id: entity for entity in scene.entities}
    assert list(found) == ["neighbours", "kept 0-1", "contradicted 0-1"]
    (line,) = found["contradicted 0-1"].lines
    assert [(p.x, p.y, p.z) for p in line.points] == list(AT)
    assert line.type == line.LINE_LIST
    assert line.color.r > 2 * line.color.g
    assert found["kept 0-1"].lines[0].color.g > 2 * found["kept 0-1"].lines[0].color.r
    about = {pair.key: pair.value for pair in found["contradicted 0-1"].metadata}
    assert about == {
        "verdict": "contradicted",
        "from": "P0.jpg",
        "to": "P1.jpg",
        "reason": "disagrees by 7 sigma",
    }


def test_places_status_and_warnings(whole):
    """3 m east of the origin on the equator are 3 / 6378148 rad of longitude at 11 m of height."""
    _, (_, fix) = messages(whole, "/slam/fix")
    assert fix.longitude == pytest.approx(np.degrees(3 / 6378148), abs=1e-11)
    assert fix.altitude == pytest.approx(11.0, abs=1e-5)
    assert fix.heading == pytest.approx(0.0)
    np.testing.assert_allclose(np.reshape(fix.position_covariance, (3, 3)), np.diag([4.0, 1, 9]), atol=1e-12)
    assert fix.position_covariance_type == fix.KNOWN
    lines = [message.message for _, message in messages(whole, "/slam/log")]
    assert lines == ["status: scale rests on GPS", "scale rests on GPS", "cam0: 1 picture lost"]


def test_an_unknown_altitude_is_no_number(tmp_path):
    origin = GeoOrigin(0.0, 0.0, 0.0, altitude_known=False)
    export_map(exported(made_map(pose(), origin=origin)), "mcap", tmp_path / "map.mcap")
    ((_, fix),) = messages(tmp_path / "map.mcap", "/slam/fix")
    assert np.isnan(fix.altitude)


def test_our_own_reader_takes_the_poses_as_a_truth(whole):
    read = flight_of(open_recording(whole), Request({"state_groundtruth_estimate0": "/slam/pose"}))
    assert read.truth is not None
    np.testing.assert_allclose(read.truth.w_T_b, [pose(AT[0]), pose(AT[1])], atol=1e-9)
    assert read.gps is not None
    assert read.epoch_ns == FIRST_NS


def test_a_sloped_floor_lies_under_the_poses(tmp_path):
    """Rasters are drawn over a level floor; 0.1 rad about x raise the north."""
    rasters(tmp_path, Grid(-4.0, 6.0, 1.0, 8, 6))
    (tmp_path / "elevation.tif").unlink()
    estimate = made_map(pose(), floor_z_m=0.0, floor_slope_rad=(0.1, 0.0))
    export_map(exported(estimate, folder=tmp_path), "mcap", tmp_path / "map.mcap")
    ((_, cloud),) = messages(tmp_path / "map.mcap", "/slam/floor")
    _, y, z, _ = np.frombuffer(cloud.data, "<f4").reshape(-1, 4).T
    np.testing.assert_allclose(z, np.tan(0.1) * y, atol=1e-6)


def test_a_map_without_camera_place_and_covariances(tmp_path):
    unknown = np.full((2, 6, 6), np.nan)
    estimate = made_map(*map(pose, AT), camera=None, origin=None, covariances=unknown)
    export_map(exported(estimate), "mcap", tmp_path / "map.mcap")
    with (tmp_path / "map.mcap").open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    assert topics == {"/slam/pose", "/slam/odometry", "/slam/path", "/slam/links", "/slam/log", "/tf"}
    (_, first), *_ = messages(tmp_path / "map.mcap", "/slam/odometry")
    assert set(first.pose_covariance) == {0.0}


def test_many_links_are_thinned_with_a_note(tmp_path, monkeypatch):
    from slam.io.exports.foxglove import links

    monkeypatch.setattr(links, "MOST_ENTITIES", 2)
    estimate = made_map(*map(pose, AT), loops=(LoopVerdict(0, 1, Rejection(LinkCheck.OTHER)),) * 5)
    notes = export_map(exported(estimate), "mcap", tmp_path / "map.mcap")
    assert notes == ("drawn: 2 of 5 unproven links; loops.csv has all",)


def test_pictures_of_another_flight_are_refused(tmp_path):
    other = flight(names=("P0.jpg", "Q1.jpg"))
    with pytest.raises(InputError, match=r"picture 1 of the flight is not P1.jpg.*slam optimize --mcap"):
        export_map(exported(made_map(*map(pose, AT)), flight=other), "mcap", tmp_path / "map.mcap")
    with pytest.raises(InputError, match="made without pictures"):
        export_map(exported(made_map(pose(), camera=None), flight=other), "mcap", tmp_path / "map.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_stamp_before_1970_is_refused(tmp_path):
    with pytest.raises(InputError, match="before 1970"):
        export_map(exported(made_map(pose(), epoch_ns=-1)), "mcap", tmp_path / "map.mcap")
    assert list(tmp_path.iterdir()) == []


def test_without_the_packages_one_line_says_how_to_install_them(tmp_path, monkeypatch):
    import importlib

    real = importlib.import_module

    def refuse(name, *args):
        if name.startswith(("mcap", "foxglove")):
            raise ImportError(name=name)
        return real(name, *args)

    monkeypatch.setattr("slam.io.exports.foxglove.foxglove_file.import_module", refuse)
    with pytest.raises(InputError, match=r"pip install 'lemniscate-slam\[foxglove\]'"):
        export_map(exported(made_map(pose())), "mcap", tmp_path / "map.mcap")
    assert list(tmp_path.iterdir()) == []
