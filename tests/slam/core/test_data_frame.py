"""The table of keyframes for pandas."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from slam.core.errors import InputError
from tests.slam.made_estimate import made_estimate


def test_the_table_holds_the_poses_and_their_deviations():
    pytest.importorskip("pandas")
    estimate = made_estimate(sigma_m=0.006)
    table = estimate.to_dataframe()
    assert len(table) == len(estimate.stamps_s)
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]].to_numpy(), estimate.w_T_b[:, :3, 3])
    variance = (table[["std_x_m", "std_y_m", "std_z_m"]] ** 2).sum(axis=1)
    np.testing.assert_allclose(variance, np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2))
    assert (table.index.as_unit("ns").astype("int64") == estimate.stamps_ns).all()
    assert str(table.index.tz) == "UTC"
    assert list(table["picture"]) == list(estimate.frame_names)


def test_unplaced_keyframes_are_nan_and_lengths_without_scale_have_their_unit():
    pytest.importorskip("pandas")
    estimate = made_estimate()
    poses = estimate.w_T_b.copy()
    poses[3] = np.nan
    table = replace(estimate, w_T_b=poses, metric=False).to_dataframe()
    assert table.iloc[3][["x_heights", "yaw_deg", "std_x_heights"]].isna().all()
    assert table["yaw_deg"].notna().sum() == len(table) - 1


def test_without_pandas_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'lemniscate-slam\[data\]'"):
        made_estimate().to_dataframe()
