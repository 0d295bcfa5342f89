"""Import of a recording of the EuRoC MAV data set as a flight.

The folders are those of the flight format, with three differences that this module resolves. The body frame
is that of the mounted IMU (x up, z forward), while a flight has forward, left, up. The reference may be the
stream of a motion-capture system (``vicon0``). A second camera and a position-only tracker may be present,
which a flight does not hold. Source: Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 35 (2016),
section 4.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.wording import counted
from slam.core.flight import Flight
from slam.core.messages import Message, about, note, warning
from slam.core.streams import Truth
from slam.io.clock import sort_by_time
from slam.io.csv_stream import read_numbers
from slam.io.csv_table import CsvTable
from slam.io.down_looking import MAX_TILT_DEG, axis_tilt_deg, tilt_remark
from slam.io.files import refusal
from slam.io.flight_folder import read_flight
from slam.io.sensor_yaml import read_yaml
from slam.io.streams import COLUMNS

Array = NDArray[np.float64]

_EUROC_ONLY = ("body.yaml", "cam1", "leica0", "vicon0")
"""Names that only EuRoC's recordings have."""
_SHARED = ("cam0", "imu0", "state_groundtruth_estimate0")
"""Names that recordings and flight folders share."""
_ARCHIVES = (".zip", ".gz", ".tgz", ".tar", ".7z", ".bag")


def is_euroc(root: Path) -> bool:
    """Return whether the folder that holds ``mav0`` may be a recording in EuRoC's body axes.

    It has no ``flight.yaml``, and it has a stream that only EuRoC has, or none that only a flight has. A
    flight that meets these conditions is imported unchanged, since its axes need no renaming.
    """
    if (root / "flight.yaml").exists():
        return False
    names = {path.name for path in (root / "mav0").iterdir() if not path.name.startswith(".")}
    return bool(names & set(_EUROC_ONLY)) or (bool(names) and names <= set(_SHARED))


def import_euroc(folder: str | Path) -> Flight:
    """Read an EuRoC recording (the folder that holds ``mav0``, or ``mav0`` itself); pictures stay on disk.

    Raises ``InputError`` if there is none or if a file violates the format.
    """
    folder = Path(folder)
    if folder.is_file() and folder.suffix.lower() in _ARCHIVES:
        raise refusal(
            folder, f"is a {folder.suffix} file, not a folder", "unpack it first and name its folder"
        )
    root = folder.resolve().parent if folder.resolve().name == "mav0" else folder
    flight, mav0 = read_flight(root, ignored=_EUROC_ONLY), root / "mav0"
    camera = _camera_down(flight, mav0)
    if camera != "cam0":
        flight = read_flight(root, camera, ignored=(*_EUROC_ONLY, "cam0"))
    present = [name for name in _EUROC_ONLY if (mav0 / name).exists()]
    remarks: list[Message] = []
    if camera != "cam0":
        remarks.append(about("cam0", f"the pictures of {camera} are used, which looks down by its T_BS"))
    elif "cam1" in present:
        remarks.append(about("cam1", "the second camera is ignored: the map is made of cam0"))
    if flight.truth is None and "vicon0" in present:
        truth, notes = _vicon(mav0 / "vicon0", root, flight.epoch_ns)
        flight = replace(flight, truth=truth)
        remarks += notes
    if flight.truth is None and "leica0" in present:
        remarks.append(
            about(
                "leica0", "holds positions without attitude, which are no truth", "ignored: record vicon0 too"
            )
        )
    flight, renamed = _to_forward_left_up(flight)
    remarks += renamed + _camera_direction_remarks(flight)
    return flight.with_warning(*remarks)


def _camera_down(flight: Flight, mav0: Path) -> str:
    """Return the first camera that looks down by its mount, else ``cam0``."""
    up = _up_in_body(flight)
    folders = sorted(path.parent for path in mav0.glob("cam[0-9]*/sensor.yaml"))
    if up is None or len(folders) < 2:
        return "cam0"
    for folder in folders:
        sensor = read_yaml(folder / "sensor.yaml", mav0.parent)
        is_whole = sensor.has("T_BS") and (folder / "data.csv").exists()
        if is_whole and axis_tilt_deg(sensor.transform()[:3, 2], up) <= MAX_TILT_DEG:
            return folder.name
    return "cam0"


def _vicon(folder: Path, root: Path, epoch_ns: int) -> tuple[Truth | None, list[Message]]:
    """Return the poses of the body, transformed from the tracker's markers by ``T_BS``, and notes."""
    table: CsvTable = read_numbers(folder / "data.csv", root, COLUMNS["state_groundtruth_estimate0"][:7])
    ordered, notes = sort_by_time({"vicon0": table})
    table = ordered["vicon0"]
    notes = [
        note("used as the ground truth").named("vicon0"),
        *(n.named("vicon0") for n in table.notes),
        *notes,
    ]
    length = np.linalg.norm(table.values[:, 3:7], axis=1)
    complete = np.isfinite(table.values).all(axis=1) & (np.abs(length - 1) < 1e-2)
    if not complete.all():
        left_out = f"{counted(int((~complete).sum()), 'row')} without a complete pose dropped"
        notes.append(about("vicon0", left_out))
    if not complete.any():
        return None, notes
    values = table.values[complete]
    w_T_s = np.tile(np.eye(4), (len(values), 1, 1))
    w_T_s[:, :3, :3] = Rotation.from_quat(values[:, 3:7], scalar_first=True).as_matrix()
    w_T_s[:, :3, 3] = values[:, :3]
    b_T_s = read_yaml(folder / "sensor.yaml", root).transform()
    return Truth((table.stamps_ns[complete] - epoch_ns) * 1e-9, w_T_s @ np.linalg.inv(b_T_s)), notes


def _to_forward_left_up(flight: Flight) -> tuple[Flight, list[Message]]:
    """Return the flight with body axes renamed so that z is up, and a remark about it.

    Only quarter turns are used, so a mount angle of a few degrees keeps its calibrated value.
    """
    has_body_axes = (flight.attitude, flight.velocity, flight.command, flight.sonar)
    up = _up_in_body(flight)
    if up is None or any(stream is not None for stream in has_body_axes):
        return flight, []
    axes = np.vstack([np.eye(3), -np.eye(3)])
    up = axes[np.argmax(axes @ up)]
    if up[2] > 0.5:
        return flight, []
    level = axes[np.abs(axes @ up) < 0.5]
    forward = level[np.argmax(level @ _forward_in_body(flight))]
    n_T_b = np.eye(4)
    n_T_b[:3, :3] = np.array([forward, np.cross(up, forward), up])
    remark = f"body axes renamed: the recording's {_axis(up)} is up and its {_axis(forward)} is forward"
    camera, imu, truth = flight.camera, flight.imu, flight.truth
    renamed = replace(
        flight,
        camera=camera and replace(camera, b_T_c=n_T_b @ camera.b_T_c),
        imu=imu and replace(imu, b_T_s=n_T_b @ imu.b_T_s),
        truth=truth and replace(truth, w_T_b=truth.w_T_b @ n_T_b.T),
    )
    return renamed, [warning(remark)]


def _up_in_body(flight: Flight) -> Array | None:
    """Return the mean direction of up in body axes, from the specific force or else from the reference."""
    if flight.imu is not None:
        return flight.imu.b_T_s[:3, :3] @ np.median(flight.imu.accel_m_s2, axis=0)
    if flight.truth is not None:
        return np.asarray(flight.truth.w_T_b[:, 2, :3].mean(axis=0))
    return None


def _forward_in_body(flight: Flight) -> Array:
    """Return the direction between the optical axis and the top of the picture. It is forward for a camera
    that looks ahead or down.
    """
    if flight.camera is None:
        return np.array([1.0, 0, 0])
    b_R_c = flight.camera.b_T_c[:3, :3]
    return b_R_c[:, 2] - b_R_c[:, 1]


def _camera_direction_remarks(flight: Flight) -> list[Message]:
    if flight.camera is None:
        return []
    tilt_deg = axis_tilt_deg(flight.camera.b_T_c[:3, 2])
    return [tilt_remark(tilt_deg).named("cam0")] if tilt_deg > MAX_TILT_DEG else []


def _axis(direction: Array) -> str:
    at = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[at] < 0 else ''}{'xyz'[at]}"
