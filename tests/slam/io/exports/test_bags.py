"""Bags of the estimate, read back by rosbags and by our own reader of recordings."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.exports.formats import export_map
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording
from tests.slam.io.exports.made_map import CAMERA, FIRST_NS, exported, made_map, pose

HALF = np.sqrt(0.5)
AT = ((1.0, 2.0, 10.0), (3.0, 4.0, 11.0))


@pytest.fixture
def bag(tmp_path):
    """A bag of two keyframes; the body may turn about its forward axis by 0.1 rad."""
    covariances = np.tile(np.diag([0.01, 0, 0, 1, 4, 9]), (2, 1, 1))
    estimate = made_map(*map(pose, AT), covariances=covariances)
    target = tmp_path / "bag"
    assert export_map(exported(estimate), "ros2", target) == ()
    return target


def messages(path, topic) -> list:
    with AnyReader([path]) as reader:
        chosen = [c for c in reader.connections if c.topic == topic]
        return [(ns, reader.deserialize(raw, c.msgtype)) for c, ns, raw in reader.messages(chosen)]


def test_poses_have_the_covariance_of_fixed_axes(bag):
    """The nose points to the north: forward is the world's y, and left its -x."""
    (first_ns, first), (second_ns, second) = messages(bag, "/slam/pose")
    assert (first_ns, second_ns) == (FIRST_NS, FIRST_NS + 10**9)
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == divmod(FIRST_NS, 10**9)
    assert first.header.frame_id == "map"
    at, q = second.pose.pose.position, first.pose.pose.orientation
    np.testing.assert_allclose((at.x, at.y, at.z), AT[1], atol=1e-12)
    np.testing.assert_allclose((q.x, q.y, q.z, q.w), (0, 0, HALF, HALF), atol=1e-12)
    covariance = np.reshape(first.pose.covariance, (6, 6))
    np.testing.assert_allclose(covariance, np.diag([4.0, 1, 9, 0, 0.01, 0]), atol=1e-12)


def test_transforms_and_path(bag):
    (_, static), *_ = messages(bag, "/tf_static")
    (mount,) = static.transforms
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "camera_optical_frame")
    q = mount.transform.rotation
    # The camera looks down with its x to the right: half a turn about the axis (1, -1, 0).
    np.testing.assert_allclose(np.abs((q.x, q.y, q.z, q.w)), (HALF, HALF, 0, 0), atol=1e-12)
    assert q.x * q.y < 0
    moving = [message.transforms[0] for _, message in messages(bag, "/tf")]
    assert [(t.header.frame_id, t.child_frame_id) for t in moving] == [("map", "base_link")] * 2
    assert [t.transform.translation.z for t in moving] == [10.0, 11.0]
    ((_, path),) = messages(bag, "/slam/path")
    assert [p.pose.position.x for p in path.poses] == [1.0, 3.0]


def test_fixes_on_earth(bag):
    """3 m east of the origin on the equator are 3 / 6378148 rad of longitude at 11 m of height."""
    _, (_, fix) = messages(bag, "/slam/fix")
    assert fix.longitude == pytest.approx(np.degrees(3 / 6378148), abs=1e-11)
    assert fix.altitude == pytest.approx(11.0, abs=1e-5)
    np.testing.assert_allclose(np.reshape(fix.position_covariance, (3, 3)), np.diag([4.0, 1, 9]), atol=1e-12)
    assert fix.position_covariance_type == 3


def test_late_subscribers_get_the_mount_and_the_path(bag):
    with AnyReader([bag]) as reader:
        kept = {
            c.topic
            for c in reader.connections
            if [q.durability for q in c.ext.offered_qos_profiles] == [QosDurability.TRANSIENT_LOCAL]
        }
    assert kept == {"/tf_static", "/slam/path"}


def test_our_own_reader_takes_the_poses_as_a_truth(bag):
    request = Request({"state_groundtruth_estimate0": "/slam/pose"})
    flight = flight_of(open_recording(bag), request)
    assert flight.truth is not None
    np.testing.assert_allclose(flight.truth.w_T_b, [pose(AT[0]), pose(AT[1])], atol=1e-9)
    assert flight.gps is not None
    assert flight.epoch_ns == FIRST_NS


def test_a_map_without_camera_place_and_covariances(tmp_path):
    unknown = np.full((2, 6, 6), np.nan)
    estimate = made_map(*map(pose, AT), camera=None, origin=None, covariances=unknown)
    export_map(exported(estimate), "ros2", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert {c.topic for c in reader.connections} == {"/slam/pose", "/slam/path", "/tf"}
    (_, first), *_ = messages(tmp_path / "bag", "/slam/pose")
    assert np.isnan(first.pose.covariance).all()


def test_an_unknown_altitude_is_no_number(tmp_path):
    """The comment of NavSatFix: quiet NaN if no altitude is available."""
    origin = GeoOrigin(0.0, 0.0, 0.0, altitude_known=False)
    export_map(exported(made_map(pose(), origin=origin)), "ros2", tmp_path / "bag")
    ((_, fix),) = messages(tmp_path / "bag", "/slam/fix")
    assert np.isnan(fix.altitude)


@pytest.mark.parametrize(("system", "altitude_m"), [("EPSG:5773", np.nan), ("EPSG:4979", 10.0), ("", 10.0)])
@pytest.mark.parametrize("kind", ["ros2", "mcap"])
def test_fixes_have_altitudes_over_the_ellipsoid_alone(kind, system, altitude_m, tmp_path):
    """The comment of NavSatFix: positive is above the WGS 84 ellipsoid."""
    origin = GeoOrigin(47.0, 8.0, 0.0, height_system=system)
    map_ = exported(made_map(pose((0.0, 0.0, 10.0)), pose((1.0, 0.0, 10.0)), origin=origin))
    notes = export_map(map_, kind, tmp_path / "map.mcap")
    flight = flight_of(open_recording(tmp_path / "map.mcap"), Request())
    np.testing.assert_allclose(flight.gps.altitude_m, altitude_m, atol=1e-5)
    assert ["takes heights over the ellipsoid" in note for note in notes] == [True] * bool(
        np.isnan(altitude_m)
    )


@pytest.mark.parametrize("epoch_ns", [-1, 2**31 * 10**9])
def test_a_stamp_that_ros_cannot_hold_is_refused(epoch_ns, tmp_path):
    with pytest.raises(InputError, match="before 1970 or after 2038"):
        export_map(exported(made_map(pose(), epoch_ns=epoch_ns)), "ros2", tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_without_the_package_one_line_says_how_to_install_it(tmp_path, monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name=name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"pip install 'lemniscate-slam\[ros\]'"):
        export_map(exported(made_map(pose(), camera=CAMERA)), "ros2", tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []
