"""The model of an uncertain lens is chosen by evidence; the pictures are projected by `made_floor`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.lens import LensEstimate
from backend.bundle.refinement import refine
from tests.backend.bundle.made_scenes import FISHEYE, WRONG_LENS
from tests.backend.made_floor import Made, Scene, make, nees

SEEDS = range(20)
BROWN = replace(WRONG_LENS, keyframes=16)


def refined(scene: Scene, seed: int) -> tuple[Made, LensEstimate, float]:
    """The lens that is found, and the mean NEES of the poses over their six degrees of freedom."""
    made = make(scene, seed)
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    assert bundle.lens is not None
    return made, bundle.lens, float(nees(bundle.w_T_b, made.w_T_b, bundle.covariances).mean()) / 6


def test_an_undeclared_fisheye_is_found():
    made, lens, _ = refined(FISHEYE, 0)
    assert lens.model == "equidistant"
    assert (np.abs(lens.calibration - made.lens) < 4 * lens.std).all()
    assert lens.is_estimated[[0, 1, 2, 3, 4]].all()


def test_a_lens_of_brown_stays_one():
    assert refined(BROWN, 0)[1].model == "brown"


@pytest.mark.slow
def test_a_model_that_is_told_is_kept():
    """Coefficients that are told belong to a model; a held lens has one too."""
    told = replace(FISHEYE.camera, distortion=(-0.3, 0.15, 0.0, 0.0, -0.05))
    assert refined(replace(FISHEYE, camera=told), 0)[1].model == "brown"
    held = replace(FISHEYE.camera, radial_std=0.0)
    assert refined(replace(FISHEYE, camera=held), 0)[1].model == "brown"


@pytest.mark.slow
def test_every_number_of_a_fisheye_is_found_within_what_it_tells():
    found = [refined(FISHEYE, seed) for seed in SEEDS]
    assert [lens.model for _, lens, _ in found] == ["equidistant"] * len(SEEDS)
    off = np.array([(lens.calibration - made.lens) / lens.std for made, lens, _ in found])
    # 95 % of a normal variable is within two deviations; 19 of 20 x 8 beyond have a chance below 0.1 %.
    assert (np.abs(off) > 2).sum() <= 18
    assert 0.6 < np.mean(off**2) < 1.5
    assert 0.6 < np.mean([squared for *_, squared in found]) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("k1", [-0.25, -0.1, 0.0, 0.1])
def test_no_lens_of_brown_becomes_a_fisheye(k1: float):
    scene = replace(BROWN, radial=k1)
    assert [refined(scene, seed)[1].model for seed in SEEDS] == ["brown"] * len(SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("k1", [-0.2, 0.0])
def test_a_narrow_view_that_tells_no_difference_stays_browns(k1: float):
    """With a small angle of view both models describe the lens, and a pinhole is what was told."""
    narrow = replace(BROWN.camera, focal_px=(1536.0, 1536.0))
    scene = replace(BROWN, camera=narrow, radial=k1, tangential=(0.0, 0.0))
    assert [refined(scene, seed)[1].model for seed in SEEDS] == ["brown"] * len(SEEDS)
