"""Errors that all pictures or positions share: found with their size, and not found where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from backend.bundle.accuracy.systematic_errors import (
    SystematicErrors,
    _by_picture,
    _eliminate,
    _Scores,
    error_test,
)
from backend.bundle.accuracy.systematic_terms import LENS_KINDS, lens_displacement
from backend.bundle.reduced_system import columns_at_once
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.sparse_cholesky import SingularMatrixError
from tests.backend.bundle.made_scenes import turned
from tests.backend.bundle.optimum_at_truth import peak_bytes
from tests.backend.made_floor import CAMERA, Made, Scene, aligned, make

SONAR = Scene()
SURVEY = Scene(
    keyframes=20,
    height_m=50.0,
    relief=0.01,
    tilt_std_rad=0.05,
    pixel_std=0.03,
    told_pixel_std=0.03,
    attitude_std_rad=None,
    range_std_m=None,
    position_std_m=(0.02, 0.04),
)
SCENES = {
    "sonar": SONAR,
    "correlated pixels": replace(SONAR, pixel_colour=0.8),
    "walls and relief": replace(SONAR, relief=0.02, walls=0.05),
    "few pictures": replace(SONAR, keyframes=6),
    "gps": replace(SURVEY, pixel_std=0.3, told_pixel_std=0.3, position_std_m=(1.0, 2.0)),
}


def solved(made: Made, **camera: object) -> Bundle:
    measurements = replace(made.measurements, camera=replace(made.measurements.camera, **camera))
    return refine(measurements, made.start, made.floor_z_m)


def systematic_errors(bundle: Bundle) -> SystematicErrors | None:
    tested = error_test(bundle.optimum, bundle.covariances)
    return None if tested is None else tested.errors


@pytest.mark.parametrize(
    ("name", "seeds"),
    [
        pytest.param("sonar", 12, marks=pytest.mark.slow),
        ("few pictures", 8),
        *(pytest.param(name, 20, marks=pytest.mark.slow) for name in SCENES),
    ],
)
def test_no_error_is_found_where_there_is_none(name: str, seeds: int) -> None:
    """The tests fail as often as their level states, and none fails at the level that is used."""
    p_values = []
    for seed in range(seeds):
        bundle = solved(make(SCENES[name], seed))
        assert systematic_errors(bundle) is None
        scores, _ = _eliminate(bundle.optimum)
        p_values += [scores.test([kind], []).p_value for kind in LENS_KINDS]
    low = np.sum(np.array(p_values) < 0.05)
    assert low <= binom.ppf(0.999, len(p_values), 0.05)
    assert np.median(p_values) > 0.2


@pytest.mark.parametrize("k1", [-0.03, -0.1])
def test_an_undeclared_distortion_is_found_with_its_size(k1: float) -> None:
    bundle = solved(make(replace(SONAR, radial=k1), 0))
    found = systematic_errors(bundle)
    assert found is not None
    assert list(found.coefficients) == ["radial"]
    assert found.alternatives == ()
    corner = np.array([CAMERA.center_px]) / CAMERA.focal_px
    seen = lens_displacement("brown", "radial", np.array(found.coefficients["radial"]), corner)
    true = lens_displacement("brown", "radial", np.array([k1, 0.0]), corner)
    np.testing.assert_allclose(seen, true, rtol=0.2)
    assert found.excess > 1.0


def test_the_displacement_of_the_poses_is_that_of_the_map() -> None:
    """The distortion alone makes the map's error: noise is small."""
    scene = replace(SONAR, pixel_std=0.02, told_pixel_std=0.02, radial=-0.03, attitude_std_rad=None)
    made = make(scene, 1)
    found = systematic_errors(solved(made))
    assert found is not None
    off = aligned(solved(made).w_T_b, made.w_T_b)[:, :3, 3] - made.w_T_b[:, :3, 3]
    assert found.shift_m == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=0.5)


def test_a_strong_distortion_is_found() -> None:
    """Linearisation fails for its size, not for its presence."""
    for seed in range(2):
        found = systematic_errors(solved(make(replace(SONAR, radial=-0.3), seed)))
        assert found is not None
        assert next(iter(found.coefficients)) == "radial"
        assert found.excess > 1.0


def quarters_at_random(seed: int) -> np.ndarray:
    return np.random.default_rng(100 + seed).integers(0, 4, SURVEY.keyframes)


def test_an_antenna_away_from_the_body_is_found() -> None:
    arm_m = np.array([0.33, 0.55, 0.0])
    for seed in (0, 1):
        made = turned(make(SURVEY, seed), quarters_at_random(seed))
        assert systematic_errors(solved(made)) is None
        moved = tuple(
            replace(p, w_p_antenna_m=p.w_p_antenna_m + made.w_T_b[p.k, :3, :3] @ arm_m)
            for p in made.measurements.positions
        )
        found = systematic_errors(
            solved(replace(made, measurements=replace(made.measurements, positions=moved)))
        )
        assert found is not None
        assert next(iter(found.coefficients)) == "position offset"
        off, std = (np.array(which["position offset"]) for which in (found.coefficients, found.stds))
        assert (np.abs(off - arm_m[:2]) < 4 * std).all()
        assert (std < 0.3).all()


def test_a_wrong_principal_point_is_found() -> None:
    shift_px = np.array([1.7, -1.2])
    made = turned(make(SURVEY, 0), quarters_at_random(0))
    found = systematic_errors(solved(made, center_px=tuple(CAMERA.center_px + shift_px)))
    assert found is not None
    assert next(iter(found.coefficients)) == "principal point"
    off_px = np.array(found.coefficients["principal point"]) * CAMERA.focal_px
    np.testing.assert_allclose(off_px, -shift_px, atol=0.3)
    assert found.excess > 1.0


@pytest.mark.slow
def test_positions_that_wander_are_no_offset() -> None:
    """Over two legs a slow error of GPS looks like a constant in body axes."""
    alarms, there = 0, SURVEY.keyframes // 2
    for seed in range(20):
        rng = np.random.default_rng(500 + seed)
        made = turned(make(SURVEY, seed), np.where(np.arange(SURVEY.keyframes) < there, 0, 2))
        off_m = [rng.normal(0.0, 0.1, 3)]
        for _ in range(1, SURVEY.keyframes):
            off_m.append(0.85 * off_m[-1] + np.sqrt(1 - 0.85**2) * rng.normal(0.0, 0.1, 3))
        moved = tuple(
            replace(p, w_p_antenna_m=p.w_p_antenna_m + off_m[p.k]) for p in made.measurements.positions
        )
        wandering = replace(made, measurements=replace(made.measurements, positions=moved))
        alarms += systematic_errors(solved(wandering)) is not None
    assert alarms == 0


def test_singular_equations_are_an_error_and_not_a_map_without_errors(monkeypatch) -> None:
    bundle = solved(make(replace(SONAR, radial=-0.1), 0))

    def singular(*_: object) -> None:
        raise SingularMatrixError(0)

    monkeypatch.setattr("backend.bundle.reduced_system.factorise", singular)
    with pytest.raises(BackendError, match="singular"):
        systematic_errors(bundle)


def test_covariances_that_are_not_known_leave_nothing_to_compare() -> None:
    bundle = solved(make(replace(SONAR, radial=-0.1), 0))
    assert systematic_errors(replace(bundle, covariances=np.full_like(bundle.covariances, np.nan))) is None


def test_draws_of_large_maps_are_solved_for_a_few_at_a_time_and_are_the_same(monkeypatch):
    bundle = solved(make(SCENES["few pictures"], 0))
    at_once, rows = _eliminate(bundle.optimum)[0].sums, len(bundle.optimum.linearise().right)
    monkeypatch.setattr("backend.bundle.reduced_system.MOST_NUMBERS", 3 * rows)
    assert columns_at_once(rows, 16) == 3
    np.testing.assert_allclose(_eliminate(bundle.optimum)[0].sums, at_once, atol=1e-9)


def test_no_two_draws_are_in_memory_where_one_is_as_large_as_is_allowed(monkeypatch):
    bundle = solved(make(SCENES["few pictures"], 0))
    peak, rows = peak_bytes(lambda: _eliminate(bundle.optimum)), len(bundle.optimum.linearise().right)
    monkeypatch.setattr("backend.bundle.reduced_system.MOST_NUMBERS", rows)
    assert peak_bytes(lambda: _eliminate(bundle.optimum)) < peak - 14 * rows * 8


@pytest.mark.parametrize("given", [[], ["decentring"], ["radial", "decentring"]])
def test_a_test_of_sums_by_picture_is_that_of_all_rows(given: list) -> None:
    """The columns that are given come off by least squares over the rows, one of them almost a multiple."""
    rng, rows, pictures = np.random.default_rng(0), 600, 12
    picture = rng.integers(0, pictures, rows)
    columns = rng.normal(size=(rows, 6)) * [1.0, 30.0, 1e-3, 1.0, 1.0, 5.0]
    columns[:, 4] = columns[:, 0] + 1e-3 * rng.normal(size=rows)
    left = rng.normal(size=(rows, 9)) + 0.05 * columns[:, 4:5]
    places = {"radial": [0, 1], "decentring": [2, 3], "principal point": [4, 5]}
    squares, sums = (_by_picture([*each.T], [*columns.T], picture, pictures) for each in (columns, left))
    found = _Scores(places, squares, sums).test(["principal point"], given)
    known = columns[:, [at for kind in given for at in places[kind]]]
    tested, residuals = (
        each - known @ np.linalg.lstsq(known, each, rcond=None)[0] for each in (columns[:, 4:], left)
    )
    information = tested.T @ tested
    np.testing.assert_allclose(
        found.coefficients, np.linalg.solve(information, tested.T @ residuals[:, 0]), rtol=1e-6
    )
    # Covariances are those of the model times a design effect of at least 1.
    effect = found.covariance @ information
    np.testing.assert_allclose(effect, effect[0, 0] * np.eye(2), atol=1e-6)
    assert effect[0, 0] > 0.1


def test_a_kind_that_others_explain_wholly_is_no_error() -> None:
    rng, picture = np.random.default_rng(1), np.arange(300) // 30
    one = rng.normal(size=(300, 2))
    columns = np.hstack([one, one @ [[2.0, 1.0], [0.0, 3.0]]])
    squares, sums = (
        _by_picture([*e.T], [*columns.T], picture, 10) for e in (columns, rng.normal(size=(300, 5)))
    )
    scores = _Scores({"radial": [0, 1], "decentring": [2, 3]}, squares, sums)
    assert scores.test(["decentring"], ["radial"]).p_value == 1.0
    assert scores.test(["decentring"], []).p_value < 1.0
