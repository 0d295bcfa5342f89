"""EuRoC recordings: header variants, renamed axes, references, refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.io.euroc import import_euroc
from slam.io.flight_folder import read_flight, write_flight

# As published with the Machine Hall recordings: the camera looks along z of a body whose x is up.
T_BC = np.array(
    [
        [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
        [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
        [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
N_R_B = np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]])
"""EuRoC's body (up, right, forward) to forward, left, up."""
EPOCH_NS = 1403636579758555392
N = 40

HEADERS = {
    "imu0": "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
    "vicon0": "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []",
    "leica0": "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]",
    "state_groundtruth_estimate0": "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], "
    "b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], "
    "b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]",
}
CAMERA = """camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
resolution: [752, 480]
"""
IMU = """gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]   ( gyro "white noise" )
gyroscope_random_walk: 1.9393e-05
accelerometer_noise_density: 2.0000e-3
accelerometer_random_walk: 3.0000e-3
"""


def sensor(kind, rate, T, more=""):
    rows = ",\n         ".join(", ".join(map(repr, row)) for row in np.asarray(T, float).tolist())
    return (
        f"#Default {kind} sensor yaml file\nsensor_type: {kind}\ncomment: made for a test\n\n"
        f"# Sensor extrinsics wrt. the body-frame.\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{rows}]\n\n"
        f"rate_hz: {rate}\n{more}"
    )


def trajectory(n_R_b=N_R_B):
    """EuRoC's body poses: level up to a few degrees, turning and moving."""
    s = np.linspace(0, 1, N)
    w_R_n = Rotation.from_euler("ZYX", np.column_stack([s, 0.1 * s, -0.05 * s]))
    w_T_b = np.tile(np.eye(4), (N, 1, 1))
    w_T_b[:, :3, :3] = w_R_n.as_matrix() @ n_R_b
    w_T_b[:, :3, 3] = np.column_stack([s, 2 * s, 1 + s])
    return w_T_b


def rows(w_T_b):
    quaternion = Rotation.from_matrix(w_T_b[:, :3, :3]).as_quat(scalar_first=True)
    return np.column_stack([w_T_b[:, :3, 3], quaternion])


def stream(root, name, values, yaml, step_ns=50_000_000):
    folder = root / "mav0" / name
    folder.mkdir(parents=True)
    if yaml:
        (folder / "sensor.yaml").write_text(yaml)
    stamps = EPOCH_NS + np.arange(len(values)) * step_ns
    lines = [f"{t},{','.join(map(repr, row))}" for t, row in zip(stamps, values.tolist(), strict=True)]
    (folder / "data.csv").write_bytes("\r\n".join([HEADERS[name], *lines, ""]).encode())


def recording(root, *streams, T_cam=T_BC, vicon_T=np.eye(4), n_R_b=N_R_B):
    """A recording with camera, IMU and the named references."""
    w_T_b = trajectory(n_R_b)
    specific_force = w_T_b[:, :3, :3].transpose(0, 2, 1) @ [0, 0, 9.81]
    stream(root, "imu0", np.hstack([np.zeros((N, 3)), specific_force]), sensor("imu", 20, np.eye(4), IMU))
    cam = root / "mav0" / "cam0"
    (cam / "data").mkdir(parents=True)
    (cam / "sensor.yaml").write_text(sensor("camera", 20, T_cam, CAMERA))
    stamps = EPOCH_NS + np.arange(3) * 50_000_000
    for k, stamp in enumerate(stamps):
        Image.fromarray(np.full((480, 752), 10 * k, np.uint8)).save(cam / "data" / f"{stamp}.png")
    (cam / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{t},{t}.png\n" for t in stamps))
    (root / "mav0" / "body.yaml").write_text("%YAML:1.0\ncomment: firefly\n")
    if "cam1" in streams:
        (root / "mav0" / "cam1").mkdir()
    if "vicon0" in streams:
        stream(root, "vicon0", rows(w_T_b @ vicon_T), sensor("vicon", 20, vicon_T))
    if "leica0" in streams:
        stream(root, "leica0", rows(w_T_b)[:, :3], sensor("position", 20, np.eye(4)))
    if "truth" in streams:
        values = np.hstack([rows(w_T_b), np.ones((N, 3)), np.zeros((N, 6))])
        stream(root, "state_groundtruth_estimate0", values, sensor("visual-inertial", 20, np.eye(4)))
    return root


def warned(flight, text):
    return [line for line in flight.warnings if text in line]


def test_a_machine_hall_recording(tmp_path):
    flight = import_euroc(recording(tmp_path / "MH_01", "truth", "cam1", "leica0"))
    assert flight.name == "MH_01"
    assert flight.epoch_ns == EPOCH_NS
    assert flight.camera.focal_px == (458.654, 457.296)
    assert flight.camera.distortion == (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
    assert flight.imu.gyro_noise_density == 1.6968e-4
    assert len(flight.frames) == 3
    assert flight.frames.load(2).mean() == 20
    assert not flight.all_keyframes
    assert_allclose(flight.truth.w_v_m_s, np.ones((N, 3)))
    assert warned(flight, "cam1: the second camera is ignored")
    assert warned(flight, "x is up and its z is forward")
    assert warned(flight, "away from straight down")
    assert not warned(flight, "leica0")
    assert not warned(flight, "not a stream")


@pytest.mark.parametrize("first", ["%YAML:1.0\n", "%YAML:1.0\n---\n"])
def test_the_first_line_of_the_published_files(tmp_path, first):
    root = recording(tmp_path, "truth")
    for path in root.glob("mav0/*/sensor.yaml"):
        path.write_text(first + path.read_text())
    assert import_euroc(root).camera.focal_px == (458.654, 457.296)
    yaml = root / "mav0" / "cam0" / "sensor.yaml"
    yaml.write_text(first + CAMERA.replace("[458.654,", "[a,"))
    with pytest.raises(InputError, match=f"line {first.count(chr(10)) + 2}"):
        import_euroc(root)


AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""A level camera that looks forward, in forward-left-up axes."""
CYCLIC = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""A body of which x is up and y forward: unlike EuRoC's, not its own inverse."""


@pytest.mark.parametrize("n_R_b", [N_R_B, CYCLIC], ids=["euroc", "cyclic"])
def test_renamed_axes_leave_the_motion_unchanged(tmp_path, n_R_b):
    T_cam = T_BC if n_R_b is N_R_B else _rigid(n_R_b.T @ AHEAD)
    flight = import_euroc(recording(tmp_path, "truth", T_cam=T_cam, n_R_b=n_R_b))
    recorded = trajectory(n_R_b)
    # Where the camera is and looks in the world, and the specific force in the world, are as recorded.
    assert_allclose(flight.truth.w_T_b @ flight.camera.b_T_c, recorded @ T_cam, atol=1e-6)
    force = flight.imu.b_T_s[:3, :3] @ flight.imu.accel_m_s2[:, :, None]
    assert_allclose((flight.truth.w_T_b[:, :3, :3] @ force)[..., 0], np.tile([0, 0, 9.81], (N, 1)), atol=1e-9)
    # The new body is level with x where the camera looks.
    assert np.all(flight.truth.w_T_b[:, 2, 2] > 0.98)
    assert flight.camera.b_T_c[0, 2] > 0.99
    assert np.linalg.det(flight.camera.b_T_c[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize("other_looks_down", [True, False])
def test_of_two_cameras_the_one_that_looks_down_is_read(tmp_path, other_looks_down):
    """The first camera looks ahead; the second one has darker pictures."""
    root = recording(tmp_path)
    down = N_R_B.T @ np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    cam = root / "mav0" / "cam1"
    (cam / "data").mkdir(parents=True)
    T_cam = _rigid(down) if other_looks_down else T_BC
    (cam / "sensor.yaml").write_text(sensor("camera", 20, T_cam, CAMERA))
    table = (root / "mav0" / "cam0" / "data.csv").read_text()
    (cam / "data.csv").write_text(table)
    for path in (root / "mav0" / "cam0" / "data").iterdir():
        Image.fromarray(np.full((480, 752), 200, np.uint8)).save(cam / "data" / path.name)
    flight = import_euroc(root)
    assert (flight.frames.load(1).mean() == 200) == other_looks_down
    assert bool(warned(flight, "the pictures of cam1 are used")) == other_looks_down
    assert bool(warned(flight, "cam1: the second camera is ignored")) != other_looks_down
    assert bool(warned(flight, "away from straight down")) != other_looks_down
    assert not warned(flight, "not a stream")


def test_level_body_with_a_down_looking_camera_is_unchanged(tmp_path):
    root = recording(tmp_path)
    down = N_R_B.T @ np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    folder = root / "mav0"
    (folder / "cam0" / "sensor.yaml").write_text(sensor("camera", 20, _rigid(down), CAMERA))
    flight = import_euroc(root)
    assert_allclose(flight.camera.b_T_c[:3, :3], [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], atol=1e-12)
    assert not warned(flight, "away from straight down")
    (folder / "imu0" / "sensor.yaml").write_text(sensor("imu", 20, _rigid(N_R_B), IMU))
    flight = import_euroc(root)
    assert_allclose(flight.camera.b_T_c[:3, :3], down, atol=1e-12)
    assert not warned(flight, "renamed")


def _rigid(R):
    T = np.eye(4)
    T[:3, :3] = R
    return T


def test_vicon_poses_are_transformed_from_the_markers_to_the_body(tmp_path):
    markers = np.eye(4)
    markers[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    markers[:3, 3] = [0.06, -0.02, 0.1]
    flight = import_euroc(recording(tmp_path, "vicon0", vicon_T=markers))
    assert_allclose(flight.truth.w_T_b[:, :3, 3], trajectory()[:, :3, 3], atol=1e-9)
    assert_allclose(flight.truth.w_T_b[:, :3, :3], trajectory()[:, :3, :3] @ N_R_B.T, atol=1e-9)
    assert flight.truth.stamps_s[:2].tolist() == pytest.approx([0, 0.05])
    assert warned(flight, "vicon0: used as the ground truth")


def test_ground_truth_estimate_is_preferred_to_vicon(tmp_path):
    flight = import_euroc(
        recording(tmp_path, "vicon0", "truth", vicon_T=_rigid(Rotation.from_rotvec([1, 0, 0]).as_matrix()))
    )
    assert_allclose(flight.truth.w_T_b[:, :3, :3], trajectory()[:, :3, :3] @ N_R_B.T, atol=1e-6)
    assert not warned(flight, "vicon0")


def test_vicon_rows_without_a_pose_are_counted(tmp_path):
    root = recording(tmp_path, "vicon0")
    path = root / "mav0" / "vicon0" / "data.csv"
    lines = path.read_text().splitlines()
    lines[3] = lines[3].rsplit(",", 4)[0] + ",0,0,0,0"
    lines[4] = lines[4].rsplit(",", 4)[0] + ",,,,"
    path.write_text("\n".join(lines) + "\n")
    flight = import_euroc(root)
    assert len(flight.truth.stamps_s) == N - 2
    assert warned(flight, "2 rows without a complete pose")


def test_positions_alone_are_not_a_reference(tmp_path):
    flight = import_euroc(recording(tmp_path, "leica0"))
    assert flight.truth is None
    assert warned(flight, "leica0: holds positions without attitude")


def test_mav0_is_accepted_as_the_folder(tmp_path):
    assert len(import_euroc(recording(tmp_path / "V1_01") / "mav0").frames) == 3


def test_recording_is_written_as_a_flight_folder(tmp_path):
    flight = import_euroc(recording(tmp_path / "in", "truth"))
    write_flight(flight, tmp_path / "out")
    again = read_flight(tmp_path / "out")
    assert again.epoch_ns == EPOCH_NS
    assert again.frames.names == flight.frames.names
    assert_allclose(again.truth.w_T_b, flight.truth.w_T_b, atol=1e-9)
    assert_allclose(again.camera.b_T_c, flight.camera.b_T_c, atol=1e-9)
    assert_allclose(again.imu.b_T_s, flight.imu.b_T_s, atol=1e-9)


def test_refusals(tmp_path):
    archive = tmp_path / "MH_01_easy.zip"
    archive.write_bytes(b"PK\x03\x04")
    (tmp_path / "empty").mkdir()
    broken = recording(tmp_path / "broken", "vicon0")
    (broken / "mav0" / "vicon0" / "data.csv").write_text(HEADERS["vicon0"] + "\n12,a,b,c,d,e,f,g\n")
    for path, words in (
        (archive, "unpack it first"),
        (tmp_path / "empty", "mav0"),
        (tmp_path / "nowhere", "does not exist"),
        (broken, "line 2"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            import_euroc(path)
        assert "\n" not in str(caught.value)
