"""A recording of the EuRoC MAV data set as a flight.

The folders are those of the flight format, with three differences that are put right here. The body is the
IMU as it is mounted (x up, z forward in EuRoC), where a flight's is forward, left, up; the reference may be a
motion-capture system's own stream (``vicon0``); a second camera and a position-only tracker may be there,
which a flight has no place for. Source: Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 35
(2016), section 4.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight, Truth
from slam.io.clock import sort_by_time
from slam.io.csv_stream import CsvTable, read_numbers
from slam.io.files import refusal
from slam.io.flight_folder import read_flight
from slam.io.sensor_yaml import read_yaml
from slam.io.streams import COLUMNS

Array = NDArray[np.float64]

_FOREIGN = ("body.yaml", "cam1", "leica0", "vicon0")
"""Names in EuRoC's recordings that a flight folder does not have."""
_SHARED = ("cam0", "imu0", "state_groundtruth_estimate0")
"""Names that both have."""
_ARCHIVES = (".zip", ".gz", ".tgz", ".tar", ".7z", ".bag")
_DOWN_LOOKING_DEG = 30.0


def is_euroc(root: Path) -> bool:
    """Whether the folder that holds ``mav0`` may be a recording whose body axes are EuRoC's.

    So it is without a ``flight.yaml`` and with a stream that only EuRoC has, or with none that only a flight
    has; a flight that looks so is imported as it is, since its axes need no renaming.
    """
    if (root / "flight.yaml").exists():
        return False
    names = {path.name for path in (root / "mav0").iterdir() if not path.name.startswith(".")}
    return bool(names & set(_FOREIGN)) or (bool(names) and names <= set(_SHARED))


def import_euroc(folder: str | Path) -> Flight:
    """Read an EuRoC recording (the folder that holds ``mav0``, or ``mav0`` itself); pictures stay on disk.

    Raises ``InputError`` where there is none or where a file breaks the format.
    """
    folder = Path(folder)
    if folder.is_file() and folder.suffix.lower() in _ARCHIVES:
        raise refusal(
            folder, f"is a {folder.suffix} file, not a folder", "unpack it first and name its folder"
        )
    root = folder.resolve().parent if folder.resolve().name == "mav0" else folder
    flight = read_flight(root)
    mav0 = root / "mav0"
    there = [name for name in _FOREIGN if (mav0 / name).exists()]
    remarks = [
        line for line in flight.warnings if not line.startswith(tuple(f"{name}: " for name in _FOREIGN))
    ]
    if "cam1" in there:
        remarks.append("cam1: the second camera is ignored")
    if flight.truth is None and "vicon0" in there:
        truth, notes = _vicon(mav0 / "vicon0", root, flight.epoch_ns)
        flight = replace(flight, truth=truth)
        remarks += [f"vicon0: {note}" for note in ("taken as the truth", *notes)]
    if flight.truth is None and "leica0" in there:
        remarks.append("leica0: holds positions without attitude, which do not make a truth; ignored")
    flight, turned = _forward_left_up(flight)
    remarks += turned + _where_the_camera_looks(flight)
    return replace(flight, warnings=tuple(remarks))


def _vicon(folder: Path, root: Path, epoch_ns: int) -> tuple[Truth | None, list[str]]:
    """The tracked body's poses, carried from the tracker's markers to the body by ``T_BS``."""
    table: CsvTable = read_numbers(folder / "data.csv", root, COLUMNS["state_groundtruth_estimate0"][:7])
    ordered, notes = sort_by_time({"vicon0": table})
    table = ordered["vicon0"]
    notes = [*table.notes, *(note.removeprefix("vicon0: ") for note in notes)]
    length = np.linalg.norm(table.values[:, 3:7], axis=1)
    whole = np.isfinite(table.values).all(axis=1) & (np.abs(length - 1) < 1e-2)
    if not whole.all():
        notes.append(f"{int((~whole).sum())} rows without a whole pose dropped")
    if not whole.any():
        return None, notes
    values = table.values[whole]
    w_T_s = np.tile(np.eye(4), (len(values), 1, 1))
    w_T_s[:, :3, :3] = Rotation.from_quat(values[:, 3:7], scalar_first=True).as_matrix()
    w_T_s[:, :3, 3] = values[:, :3]
    b_T_s = read_yaml(folder / "sensor.yaml", root).transform()
    return Truth((table.stamps_ns[whole] - epoch_ns) * 1e-9, w_T_s @ np.linalg.inv(b_T_s)), notes


def _forward_left_up(flight: Flight) -> tuple[Flight, list[str]]:
    """The flight with its body's axes renamed so that z is up, and the remark that says so.

    Only whole quarter turns: the mount's own few degrees stay where the calibration put them.
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
    forward = level[np.argmax(level @ _ahead_in_body(flight))]
    n_T_b = np.eye(4)
    n_T_b[:3, :3] = np.array([forward, np.cross(up, forward), up])
    remark = f"body axes renamed: the recording's {_axis(up)} is up and its {_axis(forward)} is forward"
    camera, imu, truth = flight.camera, flight.imu, flight.truth
    turned = replace(
        flight,
        camera=camera and replace(camera, b_T_c=n_T_b @ camera.b_T_c),
        imu=imu and replace(imu, b_T_s=n_T_b @ imu.b_T_s),
        truth=truth and replace(truth, w_T_b=truth.w_T_b @ n_T_b.T),
    )
    return turned, [remark]


def _up_in_body(flight: Flight) -> Array | None:
    """Mean direction of up in body axes, from the specific force or else from the reference."""
    if flight.imu is not None:
        return flight.imu.b_T_s[:3, :3] @ np.median(flight.imu.accel_m_s2, axis=0)
    if flight.truth is not None:
        return np.asarray(flight.truth.w_T_b[:, 2, :3].mean(axis=0))
    return None


def _ahead_in_body(flight: Flight) -> Array:
    """Between the optical axis and the top of the picture: forward for a camera that looks ahead or down."""
    if flight.camera is None:
        return np.array([1.0, 0, 0])
    b_R_c = flight.camera.b_T_c[:3, :3]
    return b_R_c[:, 2] - b_R_c[:, 1]


def _where_the_camera_looks(flight: Flight) -> list[str]:
    if flight.camera is None:
        return []
    off_deg = float(np.degrees(np.arccos(np.clip(-flight.camera.b_T_c[2, 2], -1, 1))))
    if off_deg <= _DOWN_LOOKING_DEG:
        return []
    return [f"cam0: looks {off_deg:.0f} degrees away from straight down; a map of the floor will not fit it"]


def _axis(direction: Array) -> str:
    at = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[at] < 0 else ''}{'xyz'[at]}"
