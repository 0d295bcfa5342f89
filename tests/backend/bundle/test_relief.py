"""Floor points at heights of their own: flat floors lose nothing, structure keeps its heights, what moves is
left out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

from backend.bundle.free_points import FreePoints
from backend.bundle.noise import start_noise
from backend.bundle.observations import Cameras
from backend.bundle.problem import BundleConfig
from backend.bundle.refinement import Bundle, refine
from backend.bundle.relief import LEAST_PICTURES, Heights, find_heights
from tests.backend.bundle.made_scenes import SONAR, SURVEY, errors_squared, position_rms
from tests.backend.made_floor import Made, make

SEEDS = range(12, 20)
"""The last has so many points on structure in a picture that these first draw its pose along."""
BASES = {"sonar": SONAR, "gps": replace(SURVEY, relief=0.0)}
bases = pytest.mark.parametrize("base", ["sonar", pytest.param("gps", marks=pytest.mark.slow)])


@cache
def solved(base: str, walls: float, moving: float = 0.0) -> tuple[tuple[Made, Bundle], ...]:
    made = [make(replace(BASES[base], walls=walls, moving=moving), seed) for seed in SEEDS]
    return tuple((m, refine(m.measurements, m.start, m.floor_z_m)) for m in made)


def pictures_of_points(made: Made, used: np.ndarray | None = None) -> np.ndarray:
    """(t,) number of each point's observations, or of those that are used."""
    track = made.measurements.tracks.track
    return np.bincount(track if used is None else track[used], minlength=len(made.point))


@bases
def test_a_flat_floor_gives_the_planar_result_with_its_information(base: str):
    """The reference is told that all points lie on the plane."""
    for made, bundle in solved(base, 0.0)[:4]:
        assert not bundle.optimum.problem.raised.any()
        flat, once = replace(bundle.noise, relief=1e-6), replace(BundleConfig(), rounds=1)
        planar = refine(made.measurements, made.start, made.floor_z_m, once, noise=flat)
        std, of_planar = (np.sqrt(np.einsum("nii->ni", b.covariances[1:])) for b in (bundle, planar))
        np.testing.assert_allclose(std, of_planar, rtol=0.02)
        off = position_rms(made, bundle.w_T_b) - position_rms(made, planar.w_T_b)
        assert abs(off) < 0.02 * position_rms(made, planar.w_T_b)


@bases
@pytest.mark.parametrize("walls", [0.05, 0.3])
def test_structure_keeps_its_heights_and_bends_no_map(base: str, walls: float):
    height_m, flat = BASES[base].height_m, solved(base, 0.0)
    kept, seen, drawing, of_two, off, drawn, rms = 0, 0, 0, 0, [], [], []
    for made, bundle in solved(base, walls):
        structure = made.point[:, 2] > 0.1 * height_m
        judged = structure & (pictures_of_points(made) >= LEAST_PICTURES)
        used = judged & (pictures_of_points(made, bundle.optimum.used) >= LEAST_PICTURES)
        kept, seen = kept + used.sum(), seen + judged.sum()
        two = structure & (pictures_of_points(made) == LEAST_PICTURES - 1)
        drawing += pictures_of_points(made, bundle.optimum.used)[two].sum()
        of_two += pictures_of_points(made)[two].sum()
        raised = bundle.optimum.problem.raised
        assert (pictures_of_points(made, bundle.optimum.used)[raised] >= LEAST_PICTURES).all()
        off.append((bundle.optimum.at.point[:, 2] - made.point[:, 2] / height_m)[used])
        drawn.append(errors_squared(made, bundle).mean())
        rms.append(position_rms(made, bundle.w_T_b))
    assert kept > 0.95 * seen
    assert of_two > 0
    assert drawing == 0
    assert np.median(np.abs(np.concatenate(off))) < 0.015
    assert 4.6 < np.mean(drawn) < 7.4
    assert np.mean(rms) < 1.1 * np.mean([position_rms(made, bundle.w_T_b) for made, bundle in flat])


@pytest.mark.parametrize("seed", [9, 11])
def test_ground_that_half_of_the_points_or_less_show_is_found(seed: int):
    """50 and 51 % of these points stand on structure of one height: a flat roof is as even as the ground."""
    made = make(replace(SONAR, walls=0.5), seed)
    assert np.mean(made.point[:, 2] > 0.1 * SONAR.height_m) >= 0.5
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    assert errors_squared(made, bundle).mean() < 7.4
    assert position_rms(made, bundle.w_T_b) < 0.01


@bases
def test_points_that_move_are_left_out(base: str):
    """But for the few whose motion along the flight looks like a height."""
    moving, all_moving, drawn = 0, 0, []
    for made, bundle in solved(base, 0.1, moving=0.1):
        is_moving = made.is_moving[made.measurements.tracks.track]
        moving += (bundle.optimum.used & is_moving).sum()
        all_moving += is_moving.sum()
        drawn.append(errors_squared(made, bundle).mean())
    assert moving < 0.05 * all_moving
    assert 4.6 < np.mean(drawn) < 7.4


NOISE = start_noise(make(SONAR, 0).measurements, BundleConfig())


def found_in(
    z: np.ndarray, std: float, pictures: np.ndarray | None = None, xy: np.ndarray | None = None
) -> Heights:
    """What heights with noise of a deviation show, all in one place without places (t, 2)."""
    rng, count = np.random.default_rng(1), np.full(len(z), 5) if pictures is None else pictures
    place = np.zeros((len(z), 2)) if xy is None else xy
    point = np.column_stack([place, z + rng.normal(0, std, len(z))])
    return find_heights(FreePoints(point, np.full(len(z), std**-2), count, count), count, NOISE)


def test_ground_and_structure_are_told_apart():
    rng = np.random.default_rng(2)
    roofs = rng.uniform(size=2000) < 0.3
    z = np.where(roofs, rng.uniform(0.1, 0.4, 2000), rng.normal(0, 0.01, 2000))
    found = found_in(z, 0.005)
    assert np.mean(found.raised == roofs) > 0.995
    assert found.relief == pytest.approx(0.01, rel=0.15)
    assert found.structure == pytest.approx(np.sqrt(np.mean(z[roofs] ** 2)), rel=0.1)


@pytest.mark.parametrize("relief", [0.0, 0.01, 0.1])
def test_relief_alone_is_no_structure(relief: float):
    rng = np.random.default_rng(3)
    assert not any(found_in(rng.normal(0, relief, 500), 0.005).raised.any() for _ in range(10))


def test_a_single_height_farther_off_than_others_is_no_structure():
    """The two numbers of a second kind of points must gain more than they cost."""
    z = np.random.default_rng(5).normal(0, 0.01, 500)
    z[0] = 0.045
    assert not found_in(z, 0.001).raised.any()
    z[:10] = 0.045
    assert found_in(z, 0.001).raised[:10].all()


@pytest.mark.parametrize("count", [150, 500])
@pytest.mark.parametrize("seed", [0, 1])
def test_crests_and_troughs_of_one_wave_are_no_structure(count: int, seed: int):
    """Their heights are those of two kinds of points, but neighbours rise and fall together."""
    xy = np.random.default_rng(seed).uniform(0, 1, (count, 2))
    wave = np.sin(2 * np.pi * xy).prod(axis=1)
    z = 0.1 * np.sign(wave) * np.abs(wave) ** 1.8
    five = np.full(count, 5)
    free = FreePoints(np.column_stack([xy, z]), np.full(count, 1e7), five, five)
    assert not find_heights(free, five, NOISE).raised.any()


def hills(xy: np.ndarray, signs: tuple[int, ...]) -> np.ndarray:
    """Heights (t,) of hills and hollows in a square of four on a side; the ground between them is level."""
    rng = np.random.default_rng(6)
    middles = rng.uniform(0.5, 3.5, (len(signs), 2))
    apart = np.linalg.norm(xy[:, None] - middles, axis=2)
    return np.exp(-0.5 * (apart / 0.25) ** 2) @ (0.06 * np.array(signs))


@pytest.mark.parametrize("seed", range(4))
def test_hills_and_hollows_are_no_structure_but_hills_alone_may_be(seed: int):
    """Most of the ground is level, so that two kinds explain the heights better than one of a wide spread."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 4, (500, 2))
    both, alone = (found_in(hills(xy, signs), 0.002, xy=xy) for signs in ((1, -1) * 5, (1,) * 10))
    assert not both.raised.any()
    assert both.relief > 0.01
    assert both.inflation > 2
    assert 0.2 < alone.raised.mean() < 0.6


def test_wrong_heights_below_the_ground_leave_roofs_structure():
    """As many single points lie below the ground as stand on the roofs."""
    rng = np.random.default_rng(7)
    xy = rng.uniform(0, 4, (500, 2))
    roofs = (np.abs(xy - 1.0) < 0.3).all(axis=1) | (np.abs(xy - 3.0) < 0.3).all(axis=1)
    wrong = rng.permutation(500)[: roofs.sum()]
    z = np.where(roofs, 0.1, 0.0)
    z[wrong] = -rng.uniform(0.05, 0.2, len(wrong))
    found = found_in(z, 0.002, xy=xy)
    assert found.raised[roofs].mean() > 0.9
    assert found.relief < 0.005


def test_one_pit_leaves_many_roofs_structure():
    """Its points lie beside each other, but ground that rises and falls would be below as often as above."""
    xy = np.random.default_rng(0).uniform(0, 4, (900, 2))
    middles = np.stack(np.meshgrid(*[np.linspace(0.5, 3.5, 5)] * 2), axis=-1).reshape(-1, 2)
    pit = np.linalg.norm(xy - 2.0, axis=1) < 0.45
    roofs = (np.abs(xy[:, None] - middles).max(axis=2) < 0.14).any(axis=1) & ~pit
    found = found_in(np.where(roofs, 0.1, np.where(pit, -0.1, 0.0)), 0.002, xy=xy)
    assert found.raised[roofs].mean() > 0.9
    assert found.relief < 0.005


def test_a_height_is_that_of_the_pictures_without_the_prior_of_its_fit():
    of_pictures, information = np.array([0.3, -0.2]), np.array([0.5, 40.0])
    point = np.column_stack([np.zeros((2, 2)), of_pictures * information / (information + 1.0)])
    free = FreePoints(point, information, np.full(2, 3), np.full(2, 3))
    np.testing.assert_allclose(free.height, of_pictures)
    np.testing.assert_allclose(free.variance, 1.0 / information)


def test_two_pictures_tell_no_height():
    """Such points are left out."""
    z = np.where(np.arange(500) % 4 == 0, 0.25, 0.0)
    of_three, of_two = np.full(500, LEAST_PICTURES), np.full(500, LEAST_PICTURES - 1)
    pictures = np.where(np.arange(500) % 8 == 0, of_two, of_three)
    found = found_in(z, 0.005, pictures)
    np.testing.assert_array_equal(found.raised, (z > 0) & (pictures == of_three))
    np.testing.assert_array_equal(found.doubtful, (z > 0) & (pictures == of_two))
    assert not found_in(z, 0.005, of_two).raised.any()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_ground_that_is_not_level_is_the_lowest_plane_of_many_points(share: float):
    rng = np.random.default_rng(4)
    xy, roofs = rng.uniform(-3, 3, (400, 2)), rng.uniform(size=400) < share
    point = np.column_stack([xy, 0.25 * roofs - 0.1 + xy @ [0.05, -0.03] + rng.normal(0, 0.005, 400)])
    count = np.full(400, 5)
    free = FreePoints(point, np.full(400, 0.005**-2), count, count)
    found = find_heights(free, count, NOISE, level=False)
    np.testing.assert_array_equal(found.raised, roofs)
    assert found.relief < 0.003


def test_a_free_point_is_where_its_pictures_are_fitted_best():
    made, bundle = solved("sonar", 0.05)[0]
    cost, at = bundle.optimum.cost, bundle.optimum.at
    seen, cameras = cost.observations, Cameras.of(cost.problem, at.values)
    free = FreePoints.of(seen, cameras, at.point + 0.02, np.inf)
    for t in np.flatnonzero(free.agreeing >= 4)[:5]:
        rows = slice(seen.first[t], seen.first[t + 1])
        alone = replace(
            seen, keyframe=seen.keyframe[rows], track=0 * seen.track[rows], pixel=seen.pixel[rows],
            std_px=seen.std_px[rows], prior_std=np.array([1e4, 1e4, 1.0]),
        )  # fmt: skip
        start = at.point[t]
        best = minimize(
            lambda p, alone=alone: alone.error(cameras, p[None]), start, method="Powell", tol=1e-9
        ).x
        np.testing.assert_allclose(free.point[t], best, atol=1e-5)
        np.testing.assert_allclose(free.point[t, 2], made.point[t, 2] / SONAR.height_m, atol=0.03)


def test_an_observation_that_the_others_contradict_is_left_out_of_a_free_point():
    _, bundle = solved("sonar", 0.05)[0]
    cost, at = bundle.optimum.cost, bundle.optimum.at
    seen, cameras = cost.observations, Cameras.of(cost.problem, at.values)
    right = FreePoints.of(seen, cameras, at.point, 6.0)
    t = int(np.argmax(right.agreeing))
    pixel = seen.pixel.copy()
    pixel[seen.first[t]] += [60.0, -40.0]
    found = FreePoints.of(replace(seen, pixel=pixel), cameras, at.point, 6.0)
    assert found.agreeing[t] == right.agreeing[t] - 1
    np.testing.assert_allclose(found.point[t], right.point[t], atol=0.01)
    assert (np.delete(found.agreeing, t) == np.delete(right.agreeing, t)).all()
