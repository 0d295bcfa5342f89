"""Each camera term in simulated pictures is found at its size; healthy pictures agree with the path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from frontend.camera import Camera
from slam.criticism.camera.camera_path import MOST_PICTURES, camera_path, smoothed, spread
from slam.criticism.camera.lens import LENS_MAP_PATTERN, WARPS, floor_of, pixels_of, warp
from slam.criticism.camera.photometric import PICTURE_PATTERNS
from slam.criticism.camera.reprojection import TOLERANCE, reprojection_score
from slam.criticism.kalman.filter_parameters import (
    BLUR,
    CAMERA,
    FOCAL,
    GAIN,
    POINTS,
    SQUARES,
    TILT_X,
    TILT_Y,
    VIGNETTING,
    FilterParameters,
    filter_parameters_of,
    slot,
)
from slam.criticism.kalman.kernel_inputs import LikelihoodScore, Perturbation
from slam.criticism.kalman.record import Record, record_of
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.data_quality.pictures.feature_matches import FeatureMatches
from slam.simulation.camera.effects import CameraEffects, true_camera
from slam.simulation.model import Model, load_model
from tests.slam.criticism.camera.camera_flight import camera_flight, matched_flight

DIRECTIONS = [
    *(fitted_parameter(name).perturbation for name in CAMERA),
    Perturbation("sonar.datum_m", *slot("sonar.datum_m"), 1e-3),
]


@pytest.fixture(scope="module")
def parameters() -> FilterParameters:
    return filter_parameters_of(load_model("nominal"))


def seen(terms: dict[str, dict[str, float]], seed: int) -> tuple[Record, FeatureMatches]:
    flight, matches = matched_flight(terms, seed)
    return record_of(flight), matches


def estimate(found: LikelihoodScore, entry: int) -> tuple[float, float]:
    """Size and standard deviation of one camera entry, the sonar's datum free within a centimetre."""
    datum = len(DIRECTIONS) - 1
    pivot = found.information[datum, datum] + 12 / 0.02**2
    across = found.information[entry, datum] / pivot
    information = found.information[entry, entry] - across * found.information[entry, datum]
    return (found.score[entry] - across * found.score[datum]) / information, information**-0.5


@pytest.fixture(scope="module")
def healthy(parameters: FilterParameters) -> tuple[Record, FeatureMatches, LikelihoodScore]:
    record, matches = seen({}, 3)
    return record, matches, reprojection_score(record, matches, parameters, DIRECTIONS)


@pytest.mark.slow
def test_healthy_pictures_agree_with_the_path(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore],
) -> None:
    found = healthy[2]
    assert 0.6 < found.chi_square / found.rows < 1.3
    for entry in range(POINTS):
        size, std = estimate(found, entry)
        assert abs(size) < 3.5 * std, CAMERA[entry]


@pytest.mark.parametrize(
    ("term", "size"),
    [
        ("focal_length.eps", 0.02),
        pytest.param("radial_distortion.k1", 0.04, marks=pytest.mark.slow),
        pytest.param("camera_tilt.y", 0.01, marks=pytest.mark.slow),
        pytest.param("camera_time_offset.offset", 0.01, marks=pytest.mark.slow),
        pytest.param("rolling_shutter.readout", 0.01, marks=pytest.mark.slow),
    ],
)
def test_a_camera_term_is_found_at_its_size(term: str, size: float, parameters: FilterParameters) -> None:
    name, _, parameter = term.partition(".")
    record, matches = seen({name: {parameter: size}}, 4)
    found = reprojection_score(record, matches, parameters, DIRECTIONS)
    entry = CAMERA.index(term)
    fitted, std = estimate(found, entry)
    assert fitted / std > 5.0
    assert fitted == pytest.approx(size, rel=0.15, abs=3 * std)
    held = parameters.camera.copy()
    held[entry] = size
    again = reprojection_score(record, matches, replace(parameters, camera=held), DIRECTIONS)
    left, _ = estimate(again, entry)
    assert abs(left) < 3.5 * std
    assert again.log_likelihood > found.log_likelihood + 8.0


ALL_AT_ONCE = {
    "camera_tilt": {"x": 0.01},
    "vignetting": {"a": 0.2},
    "motion_blur": {"exposure": 0.02},
    "exposure_variation": {"gain": 0.08},
}


@pytest.fixture(scope="module")
def ill(parameters: FilterParameters) -> tuple[Record, FeatureMatches, FilterParameters]:
    """A flight with all camera errors at once, and the true parameters."""
    model = Model(name="ill", terms=ALL_AT_ONCE)
    return *seen(ALL_AT_ONCE, 6), replace(parameters, camera=filter_parameters_of(model).camera)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("entry", "less", "more"),
    [(TILT_X, 0.7, 1.5), (VIGNETTING, 0.7, 1.5), (BLUR, 0.5, 3.0), (GAIN, 0.7, 1.5)],
    ids=lambda x: CAMERA[x] if isinstance(x, int) else str(x),
)
def test_pictures_are_likeliest_at_the_size_that_the_simulator_gave_each_term(
    entry: int, less: float, more: float, ill: tuple[Record, FeatureMatches, FilterParameters]
) -> None:
    """None of it, less and more are less likely, the others being known."""
    record, matches, known = ill

    def likelihood(share: float) -> float:
        camera = known.camera.copy()
        camera[entry] *= share**2 if entry in SQUARES else share
        return reprojection_score(record, matches, replace(known, camera=camera), DIRECTIONS).log_likelihood

    best = likelihood(1.0)
    assert likelihood(0.0) < best - 8.0
    assert max(likelihood(less), likelihood(more)) < best - 2.0


def test_the_errors_of_the_path_agree_with_its_covariance(parameters: FilterParameters) -> None:
    flight = camera_flight({}, 5)
    assert flight.truth is not None
    moments = np.arange(0.5, 9.5, 0.5)
    path = smoothed(record_of(flight), parameters, moments)
    at = np.searchsorted(flight.truth.stamps_s, moments)
    true = flight.truth.w_T_b[at]
    pitch = -np.arcsin(true[:, 2, 0])
    roll = np.arctan2(true[:, 2, 1], true[:, 2, 2])
    miss = np.column_stack([true[:, 2, 3], roll, pitch]) - path.poses[:, 2:5]
    keep = (6 * np.arange(len(moments))[:, None] + [2, 3, 4]).ravel()
    S = path.covariance[np.ix_(keep, keep)]
    value = float(miss.ravel() @ np.linalg.solve(S, miss.ravel()))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], miss.size)
    assert low < value < high


def test_pictures_from_the_floor_alone_say_nothing(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore], parameters: FilterParameters
) -> None:
    record, matches, _ = healthy
    stands = np.ones(len(record.times_s), dtype=bool)
    found = reprojection_score(replace(record, landing=stands), replace(matches), parameters, DIRECTIONS)
    assert (found.rows, found.log_likelihood) == (0, 0.0)
    assert not found.score.any()


def test_of_a_long_flight_pictures_of_some_seconds_on_end_are_taken(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore], parameters: FilterParameters
) -> None:
    stamps_s = np.arange(0.0, 300.0, 0.2)
    every = np.ones(len(stamps_s), dtype=bool)
    some = spread(stamps_s, every)
    assert 0.8 * MOST_PICTURES < some.sum() <= MOST_PICTURES
    lasts_s = np.diff(stamps_s[np.flatnonzero(np.diff(some.astype(int), prepend=0, append=0)[:-1])])
    assert lasts_s.max() < 40.0
    assert (spread(stamps_s[:400], every[:400]) == every[:400]).all()
    # A part of a path is as uncertain as the whole says that it is.
    record, matches, _ = healthy
    along = camera_path(record, matches, parameters)
    part = along.part(10, 25)
    assert part.times_s.tolist() == along.times_s[10:25].tolist()
    assert part.elapsed.tolist() == along.elapsed[10:25].tolist()
    assert np.flatnonzero(part.inside).tolist() == np.flatnonzero(along.inside)[10:25].tolist()
    own = slice(60, 150)
    assert np.allclose(part.covariance, along.covariance[own, own], rtol=1e-9, atol=1e-15)


def test_a_lens_projects_as_the_simulator_s_camera() -> None:
    stated = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))
    effects = CameraEffects(focal_eps=0.03, radial_k1=0.1, tilt_x_rad=0.02, tilt_y_rad=-0.03)
    vector = np.zeros(len(CAMERA))
    vector[:4] = 0.03, 0.1, 0.02, -0.03
    pose = np.array([[0.2, -0.1, 1.1, 0.0, 0.0, 0.0]])
    points = np.array([[0.3, 0.1, 0.0], [0.0, -0.3, 0.0], [0.5, -0.4, 0.0]])
    seen_at = pixels_of(stated, vector, np.tile(pose, (3, 1)), points)
    w_T_b = np.eye(4)
    w_T_b[:3, 3] = pose[0, :3]
    real = true_camera(stated, effects)
    c_T_w = np.linalg.inv(w_T_b @ real.b_T_c)
    np.testing.assert_allclose(seen_at, real.project(points @ c_T_w[:3, :3].T + c_T_w[:3, 3]), atol=1e-6)
    back = floor_of(stated, vector, np.tile(pose, (3, 1)), seen_at, np.zeros(2))
    np.testing.assert_allclose(back, points, atol=1e-4)


def test_camera_information_is_limited_by_its_tolerance(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore],
) -> None:
    for entry in (FOCAL, TILT_Y):
        assert estimate(healthy[2], entry)[1] > TOLERANCE[entry]


def test_a_model_s_camera_terms_are_held() -> None:
    held = filter_parameters_of(Model(name="blurred", terms={"motion_blur": {"exposure": 0.02}}))
    assert held.camera[CAMERA.index("motion_blur.exposure")] == pytest.approx(4e-4)


@pytest.mark.parametrize(
    "k",
    [
        # Of three warps that grow with time one stands for all.
        pytest.param(k, id=name, marks=pytest.mark.slow if "~ time" in name and "turned" not in name else ())
        for k, name in enumerate(WARPS[: WARPS.index(LENS_MAP_PATTERN)])
    ],
)
def test_a_warp_that_no_term_is_shows_at_its_size(
    k: int, parameters: FilterParameters, healthy: tuple[Record, FeatureMatches, LikelihoodScore]
) -> None:
    record, matches, _ = healthy
    size = 0.02
    elapsed = matches.stamps_s - matches.stamps_s[0]
    elapsed = elapsed / elapsed[-1] - 0.5
    off = replace(
        matches,
        pixel_i=matches.pixel_i
        + size * warp(matches.camera, matches.pixel_i, elapsed[matches.earlier])[..., k],
        pixel_j=matches.pixel_j
        + size * warp(matches.camera, matches.pixel_j, elapsed[matches.later])[..., k],
    )
    directions = [Perturbation(WARPS[k], "picture", len(PICTURE_PATTERNS) + k)]
    found = reprojection_score(record, off, parameters, directions)
    assert float(found.information[0, 0]) ** -0.5 < 0.6 * size
    assert float(found.score[0] / found.information[0, 0]) == pytest.approx(size, abs=0.3 * size)


def test_it_does_not_matter_which_picture_of_a_pair_is_the_earlier(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore], parameters: FilterParameters
) -> None:
    """Noise in the points that are carried made height seem to drift one way round, and back the other."""
    record, matches, _ = healthy
    other_way = replace(
        matches, earlier=matches.later, later=matches.earlier,
        pixel_i=matches.pixel_j, pixel_j=matches.pixel_i,
    )  # fmt: skip
    rise = [Perturbation("sonar_temperature.rise", *slot("sonar_temperature.rise"), 0.1)]
    one, other = (reprojection_score(record, s, parameters, rise) for s in (matches, other_way))
    std = one.information[0, 0] ** -0.5
    assert one.score[0] / one.information[0, 0] == pytest.approx(
        other.score[0] / other.information[0, 0], abs=0.5 * std
    )


def test_a_picture_on_the_floor_is_no_evidence(
    healthy: tuple[Record, FeatureMatches, LikelihoodScore], parameters: FilterParameters
) -> None:
    """A centimetre of another landing gear is a tenth of the height there."""
    record, matches, _ = healthy
    stands = (record.times_s > 4.0) & (record.times_s < 6.0)
    inside = camera_path(replace(record, landing=stands), replace(matches), parameters).inside
    on_floor = (matches.stamps_s > 4.0) & (matches.stamps_s < 5.9)
    before = camera_path(record, matches, parameters).inside
    assert on_floor.sum() >= 7
    assert before[on_floor].all()
    assert not inside[on_floor].any()
    in_air = (matches.stamps_s < 4.0) | (matches.stamps_s > 6.1)
    assert np.array_equal(inside[in_air], before[in_air])
