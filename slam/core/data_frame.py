"""The keyframes of an estimate as a table of pandas, for notebooks."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.rotations import roll_pitch_yaw_of

Array = NDArray[np.float64]


def keyframe_table(
    *,
    stamps_ns: NDArray[np.int64],
    names: tuple[str, ...],
    w_T_b: Array,
    covariances: Array,
    component: NDArray[np.int64],
    metric: bool,
) -> Any:
    """Return a ``pandas.DataFrame`` with one row for each keyframe, indexed by its time (UTC).

    Columns: ``picture``; ``x_m``, ``y_m``, ``z_m`` in the world; ``roll_deg``, ``pitch_deg``, ``yaw_deg``;
    ``std_x_m``, ``std_y_m``, ``std_z_m``, one standard deviation along the world's axes; ``component``, the
    connected part. Places are NaN where a keyframe was not placed. If the map is not ``metric``, lengths are
    multiples of the camera's mean height, and the columns end in ``_heights``. The arguments are fields of
    `slam.core.estimate.Estimate`.

    Raises ``InputError`` without pandas.
    """
    try:
        pandas = import_module("pandas")
    except ImportError:
        raise InputError(
            "a data frame needs pandas: install it with pip install 'lemniscate-slam[data]'"
        ) from None
    unit = "m" if metric else "heights"
    w_R_b = w_T_b[:, :3, :3]
    placed = np.isfinite(w_T_b).all(axis=(1, 2))
    variance = np.einsum("nij,njk,nik->ni", w_R_b, covariances[:, 3:, 3:], w_R_b)
    std = np.sqrt(np.where(variance >= 0, variance, np.nan))
    angles = np.full((len(w_R_b), 3), np.nan)
    angles[placed] = np.degrees(roll_pitch_yaw_of(w_R_b[placed]))
    columns: dict[str, Any] = {"picture": list(names)}
    columns |= {f"{axis}_{unit}": w_T_b[:, k, 3] for k, axis in enumerate("xyz")}
    columns |= {f"{name}_deg": angles[:, k] for k, name in enumerate(("roll", "pitch", "yaw"))}
    columns |= {f"std_{axis}_{unit}": std[:, k] for k, axis in enumerate("xyz")}
    columns["component"] = component
    times = pandas.to_datetime(stamps_ns, unit="ns", utc=True)
    return pandas.DataFrame(columns, index=pandas.Index(times, name="time"))
