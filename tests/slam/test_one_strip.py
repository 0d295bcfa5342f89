"""A map of one strip: no cross line tells the roll about it, nor all numbers of the lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.geodesy import enu_from_geodetic
from slam.core.lens_priors import as_nominal
from slam.mapping.pipeline import optimize
from slam.report.tables.instrument_errors import lens_text
from tests.slam.photo_survey import CENTER_PX, FOCAL_PX, ORIGIN, photographed, poses

TRUE_LENS = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": CENTER_PX[0], "cy": CENTER_PX[1]}


@pytest.mark.slow
@pytest.mark.parametrize(("gps_std_m", "seed"), [(0.02, 2), (3.0, 3)])
def test_what_one_strip_cannot_tell_is_held_or_told_as_uncertain(gps_std_m, seed):
    rng = np.random.default_rng(seed)
    w_T_c = poses(8, 1, rng)
    flight = photographed(w_T_c, rng, gps_std_m)
    wrong = replace(
        flight.camera, focal_px=(1.03 * FOCAL_PX,) * 2, center_px=(CENTER_PX[0] + 4, CENTER_PX[1] - 4)
    )
    estimate = optimize(replace(flight, camera=as_nominal(wrong)))
    assert estimate.placed.all()
    std = np.sqrt(np.einsum("kaa->ka", estimate.covariances)).mean(axis=0)
    shift = enu_from_geodetic(ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m, estimate.origin)
    off_m = estimate.w_T_b[:, :3, 3] - w_T_c[:, :3, 3] - shift
    assert np.sqrt((off_m**2).sum(axis=1).mean()) < 3 * np.linalg.norm(std[3:])
    b_R_true = np.swapaxes(estimate.w_T_b[:, :3, :3], 1, 2) @ w_T_c[:, :3, :3] @ flight.camera.b_T_c[:3, :3].T
    turn = Rotation.from_matrix(b_R_true).as_rotvec()
    assert (np.abs(turn).mean(axis=0) < 3 * std[:3]).all()
    if gps_std_m < 1:  # the roll about the strip is the tilt that neither its fixes nor its pictures tell
        assert std[0] > 3 * std[1]
    lens = estimate.instruments.lens
    for name, true in TRUE_LENS.items():
        assert abs(lens[name].value - true) < 3 * lens[name].std
    held = [name for name, number in lens.items() if not number.estimated]
    assert bool(held) == (gps_std_m > 1)
    assert all(f"{name} " in lens_text(lens, estimated=False) for name in held)
