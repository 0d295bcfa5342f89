"""Writing of a flight folder. The whole folder appears in one step, and numbers are read back unchanged."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import assert_never

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.core.arguments import check_flight
from slam.core.errors import one_line
from slam.core.flight import Flight
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.instrument import Instrument
from slam.core.messages import by_kind
from slam.core.progress import Progress, silent
from slam.core.streams import (
    FIELD_BY_FOLDER,
    AttitudeSeries,
    Command,
    Frames,
    Gps,
    Imu,
    Motor,
    Scalar,
    Sonar,
    Truth,
    Velocity,
)
from slam.io.atomic import atomic_folder
from slam.io.csv_header import header_of
from slam.io.frames_writer import SUFFIXES, stamps_ns, write_frames
from slam.io.landmark_table import HEADER
from slam.io.streams import COLUMNS, IMU_DENSITIES, Series

Array = NDArray[np.float64]


def write_flight(
    flight: Flight, path: Path | str, progress: Progress = silent, image_format: str = "png"
) -> None:
    """Write ``flight`` as the new folder ``path``, which appears complete or not at all.

    Pictures that are files are copied unchanged. Others are encoded as ``image_format`` ("png" or "jpg")
    under their own name with that suffix; encoded pictures of a recording are written as they are. An
    unreadable picture is listed without a file. Raises ``InputError`` if the target is not empty or cannot be
    written, ``ValueError`` for another format, and ``TypeError`` for another object.
    """
    check_flight(flight)
    if image_format not in SUFFIXES:
        raise ValueError(f"image_format {image_format!r}: png or jpg")
    with atomic_folder(path) as folder:
        (folder / "flight.yaml").write_text(_metadata_text(flight), encoding="utf-8")
        if flight.landmarks:
            _write_landmarks(flight.landmarks, folder / "landmarks.csv")
        mav0 = folder / "mav0"
        mav0.mkdir()
        comments = {source.stream: source.line() for source in flight.sources}
        if flight.camera is not None:
            (mav0 / "cam0" / "data").mkdir(parents=True)
            _write_camera(flight.camera, flight.frames, mav0 / "cam0", comments.get("cam0"))
        if flight.frames is not None:
            write_frames(flight.frames, mav0 / "cam0", flight.epoch_ns, progress, image_format)
        for name in COLUMNS:
            series: Series | None = getattr(flight, FIELD_BY_FOLDER[name])
            if series is not None:
                _write_series(series, name, mav0 / name, flight.epoch_ns, comments.get(name))


def _metadata_text(flight: Flight) -> str:
    metadata: dict[str, object] = {"name": flight.name, **{k: str(v) for k, v in flight.notes.items()}}
    for key, pairs in (("landmark_pairs", flight.landmark_pairs), ("gaps", flight.gaps)):
        if pairs:
            metadata[key] = [list(pair) for pair in pairs]
    if flight.all_keyframes:
        metadata["all_keyframes"] = True
    if flight.messages:
        metadata["assumed"] = list(flight.warnings)
    if notes := by_kind(flight.messages).notes:
        metadata["no_action"] = list(map(str, notes))
    # Without escapes, YAML would read these characters back as a blank.
    special_breaks = any(c in "".join(map(str, metadata.values())) for c in ("\x85", "\u2028", "\u2029"))
    return yaml.safe_dump(metadata, sort_keys=False, allow_unicode=not special_breaks, width=110)


def _write_landmarks(landmarks: dict[str, Array], path: Path) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        rows.writerows([name, *map(repr, np.asarray(p, float).tolist())] for name, p in landmarks.items())


def _write_series(series: Series, name: str, folder: Path, epoch_ns: int, comment: str | None) -> None:
    folder.mkdir()
    columns, values = COLUMNS[name], _values(series, len(COLUMNS[name]))
    with open(folder / "data.csv", "w", encoding="ascii", newline="") as file:
        file.write(header_of(columns[: values.shape[1]]) + "\n")
        for stamp, row in zip(stamps_ns(series.stamps_s, epoch_ns), values.tolist(), strict=True):
            file.write(f"{stamp},{','.join(repr(v) if math.isfinite(v) else '' for v in row)}\n")
    mount = series.b_T_s if isinstance(series, Imu | Sonar | Gps) else np.eye(4)
    assumed = {"assumed": list(series.assumed)} if isinstance(series, Instrument) and series.assumed else {}
    entries = _commented({**_sensor_entries(series), **assumed}, comment)
    _write_sensor(folder, name[:-1], mount, series.stamps_s, entries)


def _values(series: Series, width: int) -> Array:
    """Return (n, width) values in the format's order; NaN where the series has none.

    Accuracies of single GPS fixes, the last columns, are left out where all have the same.
    """
    match series:
        case Imu():
            return np.hstack([series.gyro_rad_s, series.accel_m_s2])
        case Sonar():
            return np.asarray(series.range_m, dtype=float)[:, None]
        case AttitudeSeries():
            return series.roll_pitch_yaw_rad
        case Velocity():
            return series.v_m_s
        case Command():
            return series.stick
        case Scalar():
            return np.asarray(series.value, dtype=float)[:, None]
        case Motor():
            return series.drive
        case Gps():
            stds_m = () if series.stds_m is None else (series.stds_m,)
            return np.column_stack([series.latitude_deg, series.longitude_deg, series.altitude_m, *stds_m])
        case Truth():
            values = np.full((len(series.stamps_s), width), np.nan)
            values[:, :3] = series.w_T_b[:, :3, 3]
            values[:, 3:7] = Rotation.from_matrix(series.w_T_b[:, :3, :3]).as_quat(
                canonical=True, scalar_first=True
            )
            if series.w_v_m_s is not None:
                values[:, 7:10] = series.w_v_m_s
            return values
    assert_never(series)


def _sensor_entries(series: Series) -> dict[str, object]:
    """Return the entries of ``sensor.yaml`` for a series, except mount and rate."""
    match series:
        case Imu():
            return {key: getattr(series, name) for key, name in IMU_DENSITIES.items()}
        case Sonar():
            return {
                "noise_std": [series.noise_std_m],
                "min_range": series.min_range_m,
                **({"max_range": series.max_range_m} if math.isfinite(series.max_range_m) else {}),
                "beam_width": series.beam_width_rad,
                "scale_std": series.scale_std,
                "datum_std": series.datum_std_m,
            }
        case AttitudeSeries():
            return {"noise_std": list(series.noise_std_rad)}
        case Velocity():
            return {"noise_std": list(series.noise_std_m_s), "scale_std": series.scale_std}
        case Command():
            return {"noise_std": [0.0] * 4, "max_tilt": series.max_tilt_rad}
        case Scalar():
            return {"noise_std": [series.noise_std]}
        case Motor():
            return {"noise_std": [0.0] * 4}
        case Gps():
            east, north, up = series.noise_std_m
            latitude = float(series.latitude_deg[0]) if len(series.latitude_deg) else 0.0
            noise = [north / METRES_PER_DEGREE, east / metres_per_degree_east(latitude), up]
            antenna = {"antenna_std": series.antenna_std_m} if series.antenna_std_m else {}
            heights = {"height_system": series.height_system} if series.height_system else {}
            return {"noise_std": noise, **antenna, **heights}
        case Truth():
            return {"noise_std": [0.0] * 16}
    assert_never(series)


def _write_camera(camera: Camera, frames: Frames | None, folder: Path, comment: str | None) -> None:
    nominal: dict[str, object] = {
        "resolution": list(camera.size_px),
        "camera_model": "pinhole",
        "intrinsics": [*camera.focal_px, *camera.center_px],
        "distortion_model": "equidistant" if camera.lens == "equidistant" else "radial-tangential",
        "distortion_coefficients": list(camera.distortion),
    }
    other = {
        "focal_std_ratio": camera.focal_std_ratio,
        "aspect_std_ratio": camera.aspect_std_ratio,
        "center_std": camera.center_std_px,
        "radial_std": camera.radial_std,
        "tangential_std": camera.tangential_std,
        "readout": camera.readout_s,
    }
    nominal.update({key: value for key, value in other.items() if value})
    if camera.mount_std_rad is not None:
        nominal["mount_std"] = camera.mount_std_rad
    stamps = frames.stamps_s if frames is not None else np.empty(0)
    _write_sensor(folder, "camera", camera.b_T_c, stamps, _commented(nominal, comment))
    (folder / "data.csv").write_text("#timestamp [ns],filename\n")


def _write_sensor(folder: Path, kind: str, mount: Array, stamps_s: Array, nominal: dict[str, object]) -> None:
    rows = [", ".join(repr(v) for v in row) for row in np.asarray(mount, dtype=float).tolist()]
    lines = [
        f"sensor_type: {kind}",
        "T_BS:",
        "  cols: 4",
        "  rows: 4",
        "  data: [" + ",\n         ".join(rows) + "]",
    ]
    if len(stamps_s) > 1:
        lines.append(f"rate_hz: {1 / max(float(np.median(np.diff(stamps_s))), 1e-9):.6g}")
    for key, value in nominal.items():
        if isinstance(value, list):
            lines.append(f"{key}: [{', '.join(repr(_python_number(v)) for v in value)}]")
        else:
            lines.append(f"{key}: {value if isinstance(value, str) else repr(_python_number(value))}")
    (folder / "sensor.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _commented(nominal: dict[str, object], comment: str | None) -> dict[str, object]:
    """Return the entries with the origin of the stream as quoted YAML text, if it is known."""
    quoted = None if comment is None else json.dumps(one_line(comment), ensure_ascii=False)
    return nominal if quoted is None else {"comment": quoted, **nominal}


def _python_number(value: object) -> object:
    """Return a numpy scalar as a Python number, since the text of a numpy scalar contains its type."""
    return value.item() if isinstance(value, np.generic) else value
