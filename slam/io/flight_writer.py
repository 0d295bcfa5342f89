"""Writing of a flight folder. The whole folder appears in one step, and numbers are read back unchanged."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import assert_never

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from frontend.workers import Workers
from slam.core.errors import one_line
from slam.core.flight import (
    FIELD_BY_FOLDER,
    AttitudeSeries,
    Command,
    Flight,
    Frames,
    Gps,
    Image,
    Imu,
    Motor,
    Scalar,
    Sonar,
    Truth,
    Velocity,
)
from slam.core.progress import Progress, silent
from slam.io.atomic import atomic_folder
from slam.io.csv_header import header_of
from slam.io.images import PictureFiles, UnreadableImageError, image_size, suffix_of
from slam.io.landmarks import HEADER
from slam.io.narrow_pictures import NarrowPictures
from slam.io.recorded_pictures import RecordedPictures
from slam.io.streams import COLUMNS, IMU_DENSITIES, METRES_PER_DEGREE, Series, metres_per_degree_east

Array = NDArray[np.float64]

ENCODERS, ENCODED_AHEAD = 2, 5
"""Threads that encode, as this takes longer than to decode; pictures that are encoded or wait for it."""
JPEG_QUALITY = 92
_JPEG = [
    *(cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]
_JPEG_OF_VIDEO = [
    *(cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420),
]
"""Videos have one colour for each four pixels; to store more takes half as much time again."""
_PNG = [
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
]
"""Compression without a search for repeats. Camera noise has none, so it is twice as fast and files are
smaller.
"""
_SUFFIXES = {"png": (".png",), "jpg": (".jpg", ".jpeg")}


def write_flight(
    flight: Flight, path: Path | str, progress: Progress = silent, image_format: str = "png"
) -> None:
    """Write ``flight`` as the new folder ``path``, which appears complete or not at all.

    Pictures that are files are copied unchanged. Others are encoded as ``image_format`` ("png" or "jpg")
    under their own name with that suffix; encoded pictures of a recording are written as they are. An
    unreadable picture is listed without a file. Raises
    ``InputError`` if the target is not empty or cannot be written, ``ValueError`` for another format.
    """
    if image_format not in _SUFFIXES:
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
            _write_frames(flight.frames, mav0 / "cam0", flight.epoch_ns, progress, image_format)
        for name in COLUMNS:
            series: Series | None = getattr(flight, FIELD_BY_FOLDER[name])
            if series is not None:
                _write_series(series, name, mav0 / name, flight.epoch_ns, comments.get(name))


def _stamps_ns(stamps_s: Array, epoch_ns: int) -> list[int]:
    return [int(s) + epoch_ns for s in np.round(np.asarray(stamps_s) * 1e9)]


def _metadata_text(flight: Flight) -> str:
    metadata: dict[str, object] = {"name": flight.name, **{k: str(v) for k, v in flight.notes.items()}}
    for key, pairs in (("landmark_pairs", flight.landmark_pairs), ("gaps", flight.gaps)):
        if pairs:
            metadata[key] = [list(pair) for pair in pairs]
    if flight.all_keyframes:
        metadata["all_keyframes"] = True
    if flight.warnings:
        metadata["assumed"] = list(flight.warnings)
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
    values = _values(series, len(COLUMNS[name])).tolist()
    with open(folder / "data.csv", "w", encoding="ascii", newline="") as file:
        file.write(header_of(COLUMNS[name]) + "\n")
        for stamp, row in zip(_stamps_ns(series.stamps_s, epoch_ns), values, strict=True):
            file.write(f"{stamp},{','.join(repr(v) if math.isfinite(v) else '' for v in row)}\n")
    mount = series.b_T_s if isinstance(series, Imu | Sonar | Gps) else np.eye(4)
    entries = _commented(_sensor_entries(series), comment)
    _write_sensor(folder, name[:-1], mount, series.stamps_s, entries)


def _values(series: Series, width: int) -> Array:
    """Return (n, width) values in the format's order; NaN where the series has none."""
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
            return np.column_stack([series.latitude_deg, series.longitude_deg, series.altitude_m])
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
                "max_range": series.max_range_m,
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
            return {"noise_std": noise, **antenna}
        case Truth():
            return {"noise_std": [0.0] * 16}
    assert_never(series)


def _write_camera(camera: Camera, frames: Frames | None, folder: Path, comment: str | None) -> None:
    nominal: dict[str, object] = {
        "resolution": list(camera.size_px),
        "camera_model": "pinhole",
        "intrinsics": [*camera.focal_px, *camera.center_px],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": list(camera.distortion),
    }
    other = {
        "focal_std_ratio": camera.focal_std_ratio,
        "aspect_std_ratio": camera.aspect_std_ratio,
        "center_std": camera.center_std_px,
        "radial_std": camera.radial_std,
        "tangential_std": camera.tangential_std,
        "mount_std": camera.mount_std_rad,
        "readout": camera.readout_s,
    }
    nominal.update({key: value for key, value in other.items() if value})
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


def _write_frames(frames: Frames, folder: Path, epoch_ns: int, progress: Progress, image_format: str) -> None:
    used: set[str] = set()
    parameters = _parameters(frames.load, image_format)
    with open(folder / "data.csv", "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["#timestamp [ns]", "filename"])

        def to_encode() -> Iterator[tuple[Image, Path]]:
            """Store the pictures that need no encoder, and yield the others."""
            for k, stamp in enumerate(_stamps_ns(frames.stamps_s, epoch_ns)):
                picture = _picture(frames, k)
                suffixes = _suffixes(picture, frames.load, image_format)
                name = _file_name(frames.names[k], k, suffixes, used)
                target = folder / "data" / name
                target.parent.mkdir(parents=True, exist_ok=True)
                if isinstance(picture, Path):
                    _copy(picture, target)
                elif isinstance(picture, bytes):
                    target.write_bytes(picture)
                elif picture is not None:
                    yield picture, target
                rows.writerow([stamp, name])
                progress("writing pictures", k + 1, len(frames))

        # Pictures are encoded while the next is read or rendered. A loader is never called by two threads.
        for _ in Workers(ENCODERS).map(_encode, parameters, to_encode(), ahead=ENCODED_AHEAD):
            pass


def _picture(frames: Frames, k: int) -> Path | bytes | Image | None:
    """Return picture k as it is stored (a file, or the bytes of one), else its pixels; None if unreadable."""
    if isinstance(frames.load, PictureFiles):
        return frames.load.paths[k]
    return frames.load.stored(k) if isinstance(frames.load, RecordedPictures) else frames.load(k)


def _suffixes(picture: Path | bytes | Image | None, load: object, image_format: str) -> tuple[str, ...]:
    if isinstance(picture, Path):
        return (picture.suffix.lower(),)
    if isinstance(picture, bytes):
        return (suffix_of(picture),)
    return _SUFFIXES[recorded.picture_format if (recorded := _recorded(load)) else image_format]


def _file_name(name: str, k: int, suffixes: tuple[str, ...], used: set[str]) -> str:
    """Return the frame's name if it is a valid file name, with the suffix of its content, else its number."""
    path = PurePosixPath(name.strip())
    if path.suffix.lower() not in suffixes:
        path = path.with_name(path.name + suffixes[0]) if path.name else path
    if (
        path.is_absolute()
        or ".." in path.parts
        or not str(path).isprintable()
        or not path.name
        or len(str(path)) > 180
    ):
        path = PurePosixPath(f"{k:06d}{suffixes[0]}")
    if str(path).lower() in used:
        path = path.with_name(f"{path.stem}_{k:06d}{path.suffix}")
    used.add(str(path).lower())
    return str(path)


def _copy(source: Path, target: Path) -> None:
    try:
        image_size(source)
    except UnreadableImageError:
        return
    shutil.copyfile(source, target)


def _recorded(load: object) -> RecordedPictures | None:
    """Return the pictures of a recording that a loader gives as they are, or reduced."""
    whole = load.whole if isinstance(load, NarrowPictures) else load
    return whole if isinstance(whole, RecordedPictures) else None


def _parameters(load: object, image_format: str) -> list[int]:
    """Return the encoder's parameters."""
    if recorded := _recorded(load):
        return _PNG if recorded.picture_format == "png" else _JPEG_OF_VIDEO
    return _PNG if image_format == "png" else _JPEG


def _encode(parameters: list[int], wanted: tuple[Image, Path]) -> None:
    image, target = wanted
    done, content = cv2.imencode(target.suffix.lower(), image, parameters)
    if not done:
        raise OSError(f"{target}: the picture cannot be encoded")
    target.write_bytes(content.tobytes())
