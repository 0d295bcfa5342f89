"""Independent writer of a flight folder, by the description of the format."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

HEADER = {
    "imu0": "w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
    "attitude0": "roll [rad],pitch [rad],yaw [rad]",
    "velocity0": "v_x [m s^-1],v_y [m s^-1]",
    "sonar0": "range [m]",
    "battery0": "voltage [V]",
    "command0": "forward [1],left [1],up [1],yaw [1]",
}
DIGITS = {
    "imu0": (5, 5, 5, 4, 4, 4), "attitude0": (5, 5, 5), "velocity0": (4, 4), "sonar0": (4,), "battery0": (3,),
    "command0": (3, 3, 3, 3),
}  # fmt: skip
SENSOR = {
    "imu0": "sensor_type: imu\nrate_hz: 100\ngyroscope_noise_density: 0.0015\ngyroscope_random_walk: 0.0\n"
    "accelerometer_noise_density: 0.05\naccelerometer_random_walk: 0.0\n",
    "attitude0": "sensor_type: attitude\nrate_hz: 50\nnoise_std: [0.005236, 0.005236, 0.005236]\n",
    "velocity0": "sensor_type: velocity\nrate_hz: 60\nnoise_std: [0.03, 0.03]\n",
    "sonar0": "sensor_type: sonar\nrate_hz: 25\nnoise_std: [0.01]\nmin_range: 0.25\nmax_range: 6\n"
    "beam_width: 0.7\n",
    "battery0": "sensor_type: battery\nrate_hz: 5\nnoise_std: [0.02]\n",
    "command0": "sensor_type: command\nrate_hz: 20\nnoise_std: [0, 0, 0, 0]\nmax_tilt: 0.5236\n",
}
LEVEL = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"


CAMERA = """sensor_type: camera
comment: down-looking camera
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0, -1, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]
rate_hz: 4
resolution: [176, 144]
camera_model: pinhole
intrinsics: [140.8, 140.8, 87.5, 71.5]
distortion_model: radial-tangential
distortion_coefficients: [0, 0, 0, 0]
"""


def logged(stick: np.ndarray, grid_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the stick at each change and at least every 50 ms."""
    changed = np.any(np.diff(stick, axis=0, prepend=stick[:1]) != 0.0, axis=1)
    keep = [0]
    for i in range(1, len(stick)):
        if changed[i] or (i - keep[-1]) * grid_s > 0.05 - 1e-9:
            keep.append(i)
    return np.array(keep) * grid_s, stick[keep]


def write(
    folder: Path,
    name: str,
    begin_s: float,
    streams: dict[str, tuple[np.ndarray, np.ndarray]],
    pictures: Sequence[tuple[float, bytes]] = (),
) -> None:
    """One flight; streams as (stamps in s from the begin, values), not a number as an empty field."""
    (folder / "mav0").mkdir(parents=True)
    text = f"name: {name}\nvehicle: quadrotor\nplace: hall\nnotes: measured flight\n"
    (folder / "flight.yaml").write_text(text, encoding="utf-8")
    for stream, (stamps, values) in streams.items():
        home = folder / "mav0" / stream
        home.mkdir()
        (home / "sensor.yaml").write_text(SENSOR[stream] + LEVEL, encoding="utf-8")
        rows = [f"#timestamp [ns],{HEADER[stream]}"]
        forms = [f"{{:.{digits}f}}" for digits in DIGITS[stream]]
        last = 0
        for stamp, row in zip(stamps, values, strict=True):
            # Increasing in each file, whatever the clock did.
            last = max(round((begin_s + stamp) * 1e9), last + 1)
            fields = ("" if np.isnan(v) else form.format(v) for form, v in zip(forms, row, strict=True))
            rows.append(f"{last},{','.join(fields)}")
        (home / "data.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    if pictures:
        home = folder / "mav0" / "cam0"
        (home / "data").mkdir(parents=True)
        (home / "sensor.yaml").write_text(CAMERA, encoding="utf-8")
        rows = ["#timestamp [ns],filename"]
        for stamp, jpeg in pictures:
            at = round((begin_s + stamp) * 1e9)
            (home / "data" / f"{at}.jpg").write_bytes(jpeg)
            rows.append(f"{at},{at}.jpg")
        (home / "data.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def without_commands(folder: Path) -> None:
    """Remove the command log of a flight."""
    shutil.rmtree(folder / "mav0" / "command0")


def shifted(folder: Path, target: Path, seconds: float = 0.0, turn: float = 0.0) -> None:
    """Write the same flight at another time, or in a rotated world frame."""
    for source in sorted(folder.rglob("*")):
        if source.is_dir():
            continue
        place = target / source.relative_to(folder)
        place.parent.mkdir(parents=True, exist_ok=True)
        text = source.read_text(encoding="utf-8")
        if source.name == "data.csv":
            head, *rows = text.splitlines()
            out = [head]
            for row in rows:
                stamp, *fields = row.split(",")
                if turn and source.parent.name == "attitude0":
                    fields[2] = f"{(float(fields[2]) + turn + np.pi) % (2.0 * np.pi) - np.pi:.5f}"
                out.append(",".join([str(int(stamp) + round(seconds * 1e9)), *fields]))
            text = "\n".join(out) + "\n"
        place.write_text(text, encoding="utf-8")
