"""Control points in the refinement: they place a map to centimetres where positions have errors of metres."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import G as POINT
from gtsam.symbol_shorthand import K as LENS
from gtsam.symbol_shorthand import X as POSE
from scipy.stats import chi2

from backend.bundle.control import survey_factor, view_factor
from backend.bundle.factors import WORLD, WORLD_SIZE
from backend.bundle.locate import locate
from backend.bundle.refinement import refine
from tests.backend.bundle.made_control import DATUM_M, SURVEYED, refined, surveyed
from tests.backend.bundle.made_scenes import position_rms
from tests.backend.made_floor import NADIR, make, nees


def test_control_points_place_a_map_to_centimetres():
    made, bundle, points, places = refined(0)
    without = refine(made.measurements, made.start, made.floor_z_m)
    assert position_rms(made, bundle.w_T_b) < 0.1 < 0.5 < position_rms(made, without.w_T_b)
    held_out = locate(bundle.optimum, points[6:])
    assert np.abs([p.w_p_m - place for p, place in zip(held_out, places[6:], strict=True)]).max() < 0.1
    assert np.abs(bundle.position_offset_m - DATUM_M).max() < 4.0
    assert bundle.noise.control < 1.5


@pytest.mark.slow
def test_the_deviations_that_are_told_are_right():
    of_poses, of_points, offsets = [], [], []
    for seed in range(20):
        made, bundle, points, places = refined(seed)
        of_poses.append(nees(bundle.w_T_b, made.w_T_b, bundle.covariances))
        for found, place in zip(locate(bundle.optimum, points[6:]), places[6:], strict=True):
            off = found.w_p_m - place
            of_points.append(off @ np.linalg.solve(found.covariance, off))
        offsets.append((bundle.position_offset_m - DATUM_M) / bundle.position_offset_std_m)
    lower, upper = chi2.ppf([0.001, 0.999], 6 * 20) / 20
    for pose in (0, 6, -1):
        assert lower < np.array(of_poses)[:, pose].mean() < upper
    lower, upper = chi2.ppf([0.001, 0.999], 3 * 40) / 40
    assert lower < np.mean(of_points) < upper
    assert 0.5 < np.mean(np.square(offsets)) < 2.0


def test_a_point_that_is_wrong_by_ten_metres_moves_the_map_little():
    made, bundle, points, places = refined(0, wrong_m=10.0)
    assert position_rms(made, bundle.w_T_b) < 0.3
    (found,) = locate(bundle.optimum, points[:1])
    assert np.linalg.norm(found.w_p_m - places[0]) < 0.3


@pytest.mark.parametrize("level_alone", [False, True])
def test_an_offset_of_a_hundred_metres_is_no_noise_of_the_positions(level_alone):
    """Where the points have no heights, the positions alone tell them: the offset is then held."""
    datum_m = np.array([100.0, -60.0, 0.0 if level_alone else 47.0])
    made, bundle, points, _ = refined(0, datum_m=datum_m)
    if level_alone:
        flat = tuple(replace(p, std_m=np.array([0.02, 0.02, np.inf])) for p in points[:6])
        measured = replace(bundle.optimum.problem.measurements, control=flat)
        bundle = refine(measured, made.start, made.floor_z_m)
    assert np.abs(bundle.position_offset_m - datum_m)[:2].max() < 4 * bundle.position_offset_std_m[:2].max()
    assert bundle.position_offset_std_m[:2].max() < 2.0
    off_m = bundle.w_T_b[:, :3, 3] - made.w_T_b[:, :3, 3]
    std_m = np.sqrt(np.diagonal(bundle.covariances, axis1=1, axis2=2)[:, 3:])
    assert (np.linalg.norm(off_m, axis=1) < 4 * np.linalg.norm(std_m, axis=1)).all()
    assert std_m[:, :2].max() < (1.0 if level_alone else 0.1)
    assert std_m[:, 2].max() < (3.0 if level_alone else 0.1)


def test_control_points_alone_place_a_map():
    """Without any position: the scale, too, comes from them."""
    made = make(SURVEYED, 1)
    points, _ = surveyed(made, 1)
    measured = replace(made.measurements, positions=(), control=tuple(points))
    bundle = refine(measured, made.start, made.floor_z_m)
    assert bundle.scale_std < 0.01
    assert position_rms(made, bundle.w_T_b) < 0.2
    assert np.isfinite(bundle.covariances).all()


@pytest.mark.parametrize("lens", ["held", "free"])
def test_jacobians(lens):
    rng = np.random.default_rng(3)
    model = gtsam.noiseModel.Unit.Create(2)
    numbers = np.array([1000.0, 990.0, 640.0, 480.0, -0.1, 0.02, 1e-3, -1e-3, 0.01])
    pose = gtsam.Pose3(NADIR).compose(gtsam.Pose3.Expmap(rng.normal(0, 0.1, 6)))
    pose = gtsam.Pose3(pose.rotation(), np.array([0.1, -0.2, 1.0]))
    values = gtsam.Values()
    values.insert(POSE(0), pose)
    values.insert(POINT(0), np.array([0.2, 0.1, 0.05]))
    values.insert(WORLD, rng.normal(0, 0.1, WORLD_SIZE))
    values.insert(LENS(0), numbers)
    held = numbers if lens == "held" else None
    factors = (
        view_factor(POSE(0), POINT(0), np.array([600.0, 500.0]), model, held),
        survey_factor(POINT(0), np.array([1.0, 2.0, 3.0]), gtsam.noiseModel.Unit.Create(3)),
    )
    for factor in factors:
        A, at = factor.linearize(values).jacobian()[0], 0
        for key in list(factor.keys()):
            size = values.dims()[key]
            numeric = np.empty((factor.dim(), size))
            for axis in range(size):
                ends = [factor.unwhitenedError(moved(values, key, axis, step)) for step in (1e-6, -1e-6)]
                numeric[:, axis] = (ends[0] - ends[1]) / 2e-6
            np.testing.assert_allclose(A[:, at : at + size], numeric, atol=1e-4, rtol=1e-6)
            at += size


def moved(values: gtsam.Values, key: int, axis: int, step: float) -> gtsam.Values:
    out, delta = gtsam.Values(values), np.zeros(values.dims()[key])
    delta[axis] = step
    if key == POSE(0):
        out.update(key, values.atPose3(key).retract(delta))
    else:
        out.update(key, np.asarray(values.atVector(key)) + delta)
    return out
