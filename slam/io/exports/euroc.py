"""Poses as the truth of a EuRoC recording: ``state_groundtruth_estimate0/data.csv``.

A map holds neither velocities nor biases of the IMU; their columns are ``nan``. Source: Burri et al., "The
EuRoC micro aerial vehicle datasets", IJRR 2016, section 3.
"""

from __future__ import annotations

from pathlib import Path

from scipy.spatial.transform import Rotation

from slam.io.csv_header import header_of
from slam.io.exports.exported_map import ExportedMap
from slam.io.streams import COLUMNS

_TRUTH = COLUMNS["state_groundtruth_estimate0"]
_POSE_COLUMNS = 7


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write one row for each keyframe: nanoseconds, position, quaternion with w first."""
    frames = exported.keyframes
    quaternions = Rotation.from_matrix(frames.w_T_b[:, :3, :3]).as_quat(scalar_first=True)
    unknown = ["nan"] * (len(_TRUTH) - _POSE_COLUMNS)
    rows = [
        ",".join([str(stamp), *(f"{v:.9f}" for v in position), *(f"{v:.12f}" for v in q), *unknown])
        for stamp, position, q in zip(
            frames.stamps_ns.tolist(), frames.w_T_b[:, :3, 3], quaternions, strict=True
        )
    ]
    target.write_text("\n".join([header_of(_TRUTH), *rows, ""]), encoding="ascii")
    return ()
