"""An estimate comes back from its files as it was, and a damaged file is one line, never a guess."""

from __future__ import annotations

import csv
import io
import json
import pickle
import zipfile
from dataclasses import fields, replace

import numpy as np
import pytest
from evo.tools import file_interface
from numpy.lib import format as npy

from backend.measurements import Rejection, RelativePose
from frontend.camera import Camera
from frontend.obstacles import Obstacle, ObstacleList
from slam.core.control_points import ControlReport, PointResidual
from slam.core.errors import InputError
from slam.core.estimate import Estimate, GroundFacts, LoopVerdict
from slam.core.floor_points import FloorPoints
from slam.core.geodesy import GeoOrigin
from slam.core.messages import about, note, reason
from slam.io.estimate import read_estimate, write_estimate
from slam.io.estimate_text import loops_text, trajectory_text
from tests.slam.evaluation.scene import estimate_of, smooth_poses


def full_estimate(seed=0, count=20) -> Estimate:
    rng = np.random.default_rng(seed)
    poses = smooth_poses(rng, count)
    poses[7] = np.nan
    component = np.where(np.arange(count) == 7, -1, 0)
    edges = tuple(
        RelativePose(i, j, np.linalg.inv(poses[i]) @ poses[j], np.eye(6) * 1e-4, kind)
        for i, j, kind in ((0, 1, "odometry"), (1, 2, "odometry"), (0, 15, "loop"))
    )
    return estimate_of(
        poses,
        component=component,
        camera=Camera(
            (301.5, 300.25), (159.5, 119.5), (320, 240), (-0.1, 0.01, 0.0, 0.001), np.diag([1.0, -1, -1, 1])
        ),
        origin=GeoOrigin(48.1, 11.5, 520.25),
        floor_z_m=-0.25,
        floor_slope_rad=(0.01, -0.02),
        relative_poses=edges,
        loops=(LoopVerdict(0, 15, None), LoopVerdict(2, 9, Rejection.read('gate, "12" of 30\nß=1'))),
        frames=80,
        rejected={"blurred": 3},
        not_placed={"a.jpg": "too few features"},
        not_drawn={"b.jpg": "black or blown out"},
        partly_drawn={"c.jpg": "40 % of its ground is far away"},
        timing_s={"solve": 0.1},
        messages=(reason("one"), about("gps0", "two"), note("three")),
        iterations=9,
        accuracy_basis="one height sensor alone",
        information_shares={"scale": {"sonar0": 0.75, "imu0": 0.25}},
        control=ControlReport(
            points=(
                PointResidual(
                    name="P",
                    role="control",
                    used=True,
                    reason="",
                    views=3,
                    residual_m=(0.1, 0.2, -0.3),
                    std_m=(0.1, 0.1, 0.2),
                    residual_px=0.5,
                ),
                PointResidual(name="Q", role="check", used=False, reason="not seen", views=0),
            ),
            gps_offset_m=(1.0, 2.0, 47.0),
            gps_offset_std_m=(0.1, 0.1, 0.2),
        ),
        ground=GroundFacts(
            misregistration_px=(0.2, 0.5), over_floor_px=(0.3, 4.0), relief_share=0.1, highest_m=2.5
        ),
        obstacles=ObstacleList(0.06, (Obstacle(1.0, -2.0, 0.3, 0.5, ("pictures", "sonar")),)),
        frame_names=tuple(f"bild ü {k}.jpg" for k in range(count)),
        ground_covariances=np.tile(0.5 * np.eye(6), (count, 1, 1)),
        joint_errors=np.tile(np.eye(6, 7) / 4, (count, 1, 1)),
        row_motion_m=np.where(np.arange(count)[:, None] < 2, [0.3, 0.01, np.nan], 0.2),
        row_turn_rad=np.full((count, 3), 0.01),
        middle_std_m=0.25,
        length_stds=((1.0, 0.01, 0.02), (5.0, 0.04, 0.06)),
        floor_points=FloorPoints(np.array([0, 2]), np.eye(3)[:2], np.array([2, 5]), np.full((2, 3), 0.01)),
    )


def same(one, other):
    if isinstance(one, np.ndarray):
        return one.dtype.kind == other.dtype.kind and np.array_equal(
            one, other, equal_nan=one.dtype.kind == "f"
        )
    if isinstance(one, tuple):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return one == other or (one != one and other != other)


@pytest.mark.parametrize(
    "made", [full_estimate(), estimate_of(np.zeros((0, 4, 4))), estimate_of(np.eye(4)[None])]
)
def test_written_estimate_is_read_back_unchanged(made, tmp_path):
    paths = write_estimate(made, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    back = read_estimate(tmp_path)
    assert (made.folder, back.folder) == (None, tmp_path)
    for field in fields(Estimate):
        if field.compare and field.name != "stamps_s":
            assert same(getattr(made, field.name), getattr(back, field.name)), field.name
    np.testing.assert_allclose(back.stamps_s, made.stamps_s, atol=1e-9)
    np.testing.assert_array_equal(back.stamps_ns, made.stamps_ns)


def test_an_estimate_of_an_earlier_version_has_no_ground_points(tmp_path):
    write_estimate(full_estimate(), tmp_path)
    with np.load(tmp_path / "estimate.npz") as arrays:
        earlier = {name: arrays[name] for name in arrays.files if not name.startswith("point_")}
    np.savez(tmp_path / "estimate.npz", **earlier)
    assert read_estimate(tmp_path).floor_points is None


def test_an_estimate_of_an_earlier_version_names_a_field_of_the_camera_otherwise(tmp_path):
    made = full_estimate()
    write_estimate(made, tmp_path)
    with np.load(tmp_path / "estimate.npz") as arrays:
        earlier = {name: arrays[name] for name in arrays.files}
    renamed = json.loads(str(earlier["record"]))
    renamed["camera"]["told"] = renamed["camera"].pop("stated")
    np.savez(tmp_path / "estimate.npz", **{**earlier, "record": np.array(json.dumps(renamed))})
    assert same(read_estimate(tmp_path).camera, made.camera)


def test_documented_arrays_are_read_without_pickle(tmp_path):
    made = full_estimate()
    write_estimate(made, tmp_path)
    with np.load(tmp_path / "estimate.npz", allow_pickle=False) as arrays:
        assert arrays["stamps"].dtype == np.int64
        np.testing.assert_array_equal(arrays["stamps"], made.stamps_ns)
        np.testing.assert_array_equal(arrays["w_T_b"], made.w_T_b)
        np.testing.assert_array_equal(arrays["covariances"], made.covariances)
        assert all(arrays[name].dtype != object for name in arrays.files)


def test_tum_stamps_are_exact_and_evo_reads_the_poses(tmp_path):
    made = full_estimate()
    write_estimate(made, tmp_path)
    lines = [
        line.split() for line in (tmp_path / "trajectory.tum").read_text().splitlines() if line[0] != "#"
    ]
    placed = np.flatnonzero(np.isfinite(made.w_T_b).all(axis=(1, 2)))
    assert [line[0] for line in lines] == [
        f"{ns // 10**9}.{ns % 10**9:09d}" for ns in made.stamps_ns[placed].tolist()
    ]
    theirs = file_interface.read_tum_trajectory_file(tmp_path / "trajectory.tum")
    np.testing.assert_allclose(np.stack(theirs.poses_se3), made.w_T_b[placed], atol=1e-9)


def test_a_stamp_before_zero_keeps_its_sign():
    made = replace(estimate_of(np.eye(4)[None]), epoch_ns=-1_500_000_000)
    assert trajectory_text(made).splitlines()[1].startswith("-1.500000000 ")


def test_loops_csv_quotes_any_reason():
    made = full_estimate()
    rows = list(csv.DictReader(io.StringIO(loops_text(made))))
    assert [(row["i"], row["j"], row["verdict"]) for row in rows] == [
        ("0", "15", "kept"),
        ("2", "9", "rejected"),
    ]
    assert rows[1]["reason"] == made.loops[1].reason
    assert int(rows[1]["stamp_j [ns]"]) == made.stamps_ns[9]


@pytest.fixture
def written(tmp_path):
    write_estimate(full_estimate(), tmp_path)
    return tmp_path / "estimate.npz"


def assert_refused(path):
    with pytest.raises(InputError) as error:
        read_estimate(path.parent)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


def rewritten(path, change):
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    contents |= change
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            if content is not None:
                archive.writestr(name, content)


def stored(array, **options):
    content = io.BytesIO()
    np.save(content, array, **options)
    return content.getvalue()


def record(**change):
    """A record that is whole but for ``change``."""
    whole = {
        "name": "a", "status": "ok", "epoch_ns": 0, "camera": None, "floor_z_m": 0.0,
        "floor_slope_rad": [0.0, 0.0], "origin": None, "frames": 80, "rejected": {}, "timing_s": {},
        "warnings": [], "graph_error": 0.0, "iterations": 1,
    }  # fmt: skip
    return stored(np.array(json.dumps(whole | change)))


def test_error_of_a_missing_file_names_the_command(tmp_path):
    assert "slam optimize" in assert_refused(tmp_path / "estimate.npz")


def test_recompressed_file_is_read(written):
    rewritten(written, {"record.npy": record()})
    assert read_estimate(written.parent).frames == 80


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("w_T_b.npy", None),
        ("w_T_b.npy", b""),
        ("w_T_b.npy", stored(np.zeros((20, 4, 3)))),
        ("w_T_b.npy", stored(np.zeros((19, 4, 4)))),
        ("w_T_b.npy", stored(np.zeros((20, 4, 4), dtype=complex))),
        ("stamps.npy", stored(np.zeros(20))),
        ("stamps.npy", stored(np.array(3))),
        ("loop_ij.npy", stored(np.array([[0, 99], [0, 1]]))),
        ("frame_names.npy", stored(np.array([{"a": 1}] * 20), allow_pickle=True)),
        ("record.npy", stored(np.array("[" * 100_000))),
        ("record.npy", stored(np.array("{}"))),
        ("record.npy", record(floor_slope_rad=[0.1])),
        ("w_T_b.npy", stored(np.zeros((20, 4, 4)))),
        ("w_T_b.npy", stored(np.tile(np.diag([1e300, 1e300, 1e300, 1]), (20, 1, 1)))),
        ("w_T_b.npy", stored(np.tile(np.eye(4), (20, 1, 1)) + np.eye(4)[:, 3:] * [0, 0, 0, 1e3])),
        ("chain_w_T_b.npy", stored(np.tile(np.eye(4) + 1e13 * np.eye(4, k=3), (20, 1, 1)))),
        ("record.npy", stored(np.array('["name"]'))),
    ],
)
def test_another_shape_or_content_is_refused(written, name, content):
    rewritten(written, {name: content})
    assert_refused(written)


def test_pickled_content_is_refused(written):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("the pickle was run",))

    rewritten(written, {"frame_names.npy": stored(np.array([Bomb()] * 20, dtype=object), allow_pickle=True)})
    assert_refused(written)
    written.write_bytes(pickle.dumps([Bomb()]))
    assert_refused(written)


def header(shape):
    content = io.BytesIO()
    npy.write_array_header_1_0(content, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return content.getvalue()


@pytest.mark.parametrize(
    "content", [header((20_000_000_000, 4, 4)), header((-20, 4, 4)), header((20, 4, 4)).replace(b"}", b" ")]
)
def test_wrong_array_length_is_refused_before_allocation(written, content):
    rewritten(written, {"w_T_b.npy": content})
    assert_refused(written)


def test_decompression_bomb_is_refused_by_its_directory(written):
    rewritten(written, {"w_T_b.npy": stored(np.zeros((1_000_000, 4, 4)))})
    assert written.stat().st_size < 1_000_000
    assert "unpacks to" in assert_refused(written)


@pytest.mark.parametrize("seed", range(60))
def test_any_damage_is_refused_or_harmless(written, seed):
    """Cut, zeroed or flipped at random: one line, or the very same estimate where only padding was hit."""
    rng = np.random.default_rng(seed)
    content = bytearray(written.read_bytes())
    place = int(rng.integers(0, len(content)))
    kind = seed % 3
    if kind == 0:
        content = content[:place]
    elif kind == 1:
        content[place:] = bytes(len(content) - place)
    else:
        content[place] ^= 1 << int(rng.integers(0, 8))
    written.write_bytes(content)
    try:
        back = read_estimate(written.parent)
    except InputError:
        assert_refused(written)
        return
    assert kind == 2
    for field in fields(Estimate):
        if field.compare and field.name != "stamps_s":
            assert same(getattr(full_estimate(), field.name), getattr(back, field.name))
