"""The refinement on made cameras over a made floor: truth found, covariances honest, noise levels told."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend.bundle.graph import BundleConfig, BundleProblem, build_graph, start_calibration, start_values
from backend.bundle.noise import same_noise, start_noise
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import Measurements
from tests.backend.made_floor import CAMERA, NADIR, Made, Scene, aligned, make, mark_nees, nees

SEEDS = range(20)


def tilted_mount() -> np.ndarray:
    """A camera that looks 20 degrees forward and sits off the body's origin."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", -20, degrees=True).as_matrix() @ NADIR[:3, :3]
    T[:3, 3] = [0.10, 0.02, -0.05]
    return T


SONAR = Scene()
SURVEY = Scene(height_m=50.0, relief=0.01, attitude_std_rad=None, range_std_m=None, position_std_m=(1.0, 2.0))
ROUGH = replace(SONAR, relief=0.03)
SCENES = {
    "sonar": SONAR,
    "sonar, no attitude": replace(SONAR, attitude_std_rad=None),
    "pixels three times as noisy as told": replace(SONAR, pixel_std=0.9),
    "relief": replace(SONAR, relief=0.02),
    "relief and a coarse sonar": replace(SONAR, relief=0.03, range_std_m=0.05),
    "tilted mount": replace(SONAR, camera=replace(CAMERA, b_T_c=tilted_mount())),
    "gps": SURVEY,
    "gps and attitude": replace(SURVEY, attitude_std_rad=0.01),
    "gps over a slope": replace(SURVEY, slope_rad=(0.04, -0.03)),
    "gps and attitude over a slope": replace(SURVEY, attitude_std_rad=0.01, slope_rad=(0.04, -0.03)),
    "gps, camera unknown": replace(
        SURVEY,
        camera=replace(CAMERA, focal_std_ratio=0.03, radial_std=0.05),
        focal_ratio=1.02,
        radial=-0.03,
        tilt_std_rad=0.15,
    ),
}
SLOWER = (
    "sonar, no attitude", "pixels three times as noisy as told", "relief and a coarse sonar",
    "gps and attitude over a slope",
)  # fmt: skip
"""Each is two of the others together, or has a test of its own in test_noise.py."""
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in SLOWER else name for name in SCENES]


@lru_cache
def solved(name: str) -> tuple[tuple[Made, Bundle], ...]:
    """A scene drawn and refined twenty times."""
    made = [make(SCENES[name], seed) for seed in SEEDS]
    return tuple((m, refine(m.measurements, m.start, m.floor_z_m)) for m in made)


def errors_squared(made: Made, bundle: Bundle) -> np.ndarray:
    """NEES of all poses, or of all but the first where that one is the origin."""
    if made.measurements.positions:
        return nees(bundle.w_T_b, made.w_T_b, bundle.covariances)
    hat = aligned(bundle.w_T_b, made.w_T_b)
    return nees(hat[1:], made.w_T_b[1:], bundle.covariances[1:])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["height of the floor by a coarse gps", "scale by a coarse sonar"])
def test_landmark_covariances_are_consistent(name: str):
    """A floor of unknown height misplaces no mark; a wrong scale moves marks from the floor's origin."""
    scene = {
        "height of the floor by a coarse gps": Scene(position_std_m=(0.02, 0.5), slope_rad=(0.04, -0.03)),
        "scale by a coarse sonar": Scene(range_std_m=0.2),
    }[name]
    drawn = []
    for seed in range(40):
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start, made.floor_z_m)
        drawn.append([mark_nees(made, bundle, k) for k in (1, scene.keyframes // 2 - 1)])
    of_each = np.sum(drawn, axis=0)
    assert (chi2.ppf(0.0005, 2 * len(drawn)) < of_each).all()
    assert (of_each < chi2.ppf(0.9995, 2 * len(drawn))).all()


def position_rms(made: Made, w_T_b: np.ndarray) -> float:
    hat = w_T_b if made.measurements.positions else aligned(w_T_b, made.w_T_b)
    return float(np.sqrt(np.mean(np.sum((hat - made.w_T_b)[:, :3, 3] ** 2, axis=1))))


@pytest.mark.parametrize("name", NAMES)
def test_pose_covariances_are_consistent(name: str):
    """One pose a draw is independent of other draws: its sum is chi-square. All poses: a closer look."""
    drawn = np.array([errors_squared(made, bundle) for made, bundle in solved(name)])
    lower, upper = chi2.ppf([0.001, 0.999], 6 * len(SEEDS)) / len(SEEDS)
    for pose in (drawn.shape[1] // 2, -1):
        assert lower < drawn[:, pose].mean() < upper
    assert 4.6 < drawn.mean() < 7.4


@pytest.mark.parametrize("name", NAMES)
def test_noise_levels_are_recovered(name: str):
    scene, found = SCENES[name], [bundle.noise for _, bundle in solved(name)]
    expected = {"pixel_scale": scene.pixel_std / scene.told_pixel_std}
    if scene.relief:
        expected["relief"] = scene.relief
    if scene.range_std_m is not None:
        expected["range_m"] = scene.range_std_m
    if scene.attitude_std_rad is not None:
        # Chance autocorrelation of few keyframes counts upward only; what poses follow of the attitudes where
        # pictures are poor, downward.
        level = np.mean([level.roll_pitch_rad for level in found])
        assert 0.9 * scene.attitude_std_rad < level < 1.35 * scene.attitude_std_rad
    for kind, put_in in expected.items():
        assert np.mean([getattr(level, kind) for level in found]) == pytest.approx(put_in, rel=0.2), kind
    if scene.position_std_m is not None:
        horizontal, _, vertical = np.mean([level.position_m for level in found], axis=0)
        assert (horizontal, vertical) == pytest.approx(scene.position_std_m, rel=0.2)
    if not scene.relief:
        assert np.mean([level.relief for level in found]) < 0.004


def test_sensor_noise_above_the_nominal_one_is_estimated():
    """Attitudes and ranges with three times the noise that their makers tell."""
    scene, found = replace(SONAR, attitude_std_rad=0.03, range_std_m=0.03, keyframes=24), []
    for seed in SEEDS:
        made = make(scene, seed)
        nominal = replace(
            made.measurements,
            attitudes=tuple(replace(a, std_rad=a.std_rad / 3) for a in made.measurements.attitudes),
            ranges=tuple(replace(r, std_m=r.std_m / 3) for r in made.measurements.ranges),
        )
        found.append(refine(nominal, made.start).noise)
    assert np.mean([level.roll_pitch_rad for level in found]) == pytest.approx(0.03, rel=0.2)
    assert np.mean([level.range_m for level in found]) == pytest.approx(0.03, rel=0.2)


@pytest.mark.parametrize("name", NAMES)
def test_no_good_observation_is_dropped(name: str):
    dropped = sum(bundle.dropped_observations for _, bundle in solved(name))
    assert dropped <= 1e-3 * sum(len(made.measurements.tracks.track) for made, _ in solved(name))


def test_exact_measurements_give_back_the_truth():
    """Start, scale and heights were centimetres off."""
    scene = replace(
        SONAR, pixel_std=1e-3, told_pixel_std=1e-3, attitude_std_rad=1e-5, range_std_m=1e-5, tilt_std_rad=0.1
    )
    made = make(scene, 1)
    bundle = refine(made.measurements, made.start)
    assert position_rms(made, made.start) > 0.01
    assert np.abs(aligned(bundle.w_T_b, made.w_T_b) - made.w_T_b).max() < 1e-4
    assert bundle.floor_slope_rad == pytest.approx((0.0, 0.0), abs=1e-4)


def test_exact_positions_give_back_a_leaning_floor():
    scene = replace(
        SURVEY,
        pixel_std=1e-3,
        told_pixel_std=1e-3,
        relief=0,
        position_std_m=(1e-3, 1e-3),
        slope_rad=(0.04, -0.03),
    )
    made = make(scene, 1)
    bundle = refine(made.measurements, made.start, made.floor_z_m - 2.0)
    assert np.abs(bundle.w_T_b - made.w_T_b).max() < 0.01
    assert bundle.floor_slope_rad == pytest.approx((0.04, -0.03), abs=1e-4)
    assert bundle.floor_z_m == pytest.approx(made.floor_z_m, abs=0.01)


def test_the_lens_is_found():
    """Tilted pictures over a floor tell the focal length; the corners tell the distortion."""
    found = [bundle for _, bundle in solved("gps, camera unknown")]
    focal = np.array([bundle.focal_px[0] for bundle in found]) / CAMERA.focal_px[0]
    assert focal.mean() == pytest.approx(1.02, abs=0.006)
    assert 0.001 < focal.std() < 0.02
    assert np.mean([bundle.radial[0] for bundle in found]) == pytest.approx(-0.03, abs=0.01)


def test_a_lens_that_is_known_is_held():
    assert all(b.focal_px == CAMERA.focal_px and b.radial == (0.0, 0.0) for _, b in solved("gps"))


def test_attitudes_observe_the_slope_of_the_ground():
    """Gravity is the world's, not the floor's: with attitudes the slope is found several times as well."""
    off = {
        name: np.std([np.subtract(b.floor_slope_rad, (0.04, -0.03)) for _, b in solved(name)])
        for name in ("gps over a slope", "gps and attitude over a slope")
    }
    assert 0.001 < off["gps and attitude over a slope"] < 0.005 < off["gps over a slope"]


def misled(made: Made, told_rad: float) -> Measurements:
    """Roll 7 degrees wrong over the second half, as a side wind does to a small drone's own attitude."""
    half = made.measurements.count // 2
    wrong = tuple(
        replace(
            a,
            roll_pitch_yaw_rad=a.roll_pitch_yaw_rad + [np.radians(7.0) * (a.k >= half), 0, 0],
            std_rad=np.full(3, told_rad),
        )
        for a in made.measurements.attitudes
    )
    return replace(made.measurements, attitudes=wrong)


def test_noise_levels_converge():
    """Attitudes that are degrees off look like relief until they are believed less, which takes rounds."""
    scene = replace(SONAR, attitude_std_rad=0.005)
    for seed in range(3):
        made = make(scene, seed)
        measured = misled(made, 0.005)
        found = refine(measured, made.start)
        again = refine(measured, made.start, noise=found.noise)
        assert same_noise(found.noise, again.noise)


def test_height_uncertainty_of_a_sonar_includes_the_relief():
    """Whether it hears tops or what lies between them nobody knows, however exact it is told to be."""
    level, rough = (refine((m := make(scene, 0)).measurements, m.start) for scene in (SONAR, ROUGH))
    assert level.range_errors.zero_std_m < 0.003
    assert rough.range_errors.zero_std_m == pytest.approx(ROUGH.relief * ROUGH.height_m, rel=0.3)
    assert rough.scale_std == pytest.approx(ROUGH.relief, rel=0.3)


def test_one_position_far_off_leaves_scale_and_noise_as_they_are():
    """The noise of GPS was the root mean square of its residuals: one outlier made every fix worthless."""
    made = make(replace(SURVEY, points_in_view=15), 0)
    clean = refine(made.measurements, made.start, made.floor_z_m)
    first, *others = made.measurements.positions
    moved = replace(first, w_p_b_m=first.w_p_b_m + [400.0, 0.0, 0.0])
    with_outlier = refine(replace(made.measurements, positions=(moved, *others)), made.start, made.floor_z_m)
    assert with_outlier.noise.position_m[0] < 2.5 * clean.noise.position_m[0]
    assert with_outlier.scale_std < 2.5 * clean.scale_std
    lengths = [
        np.linalg.norm(np.diff(b.w_T_b[:, :3, 3], axis=0), axis=1).sum() for b in (clean, with_outlier)
    ]
    assert lengths[1] == pytest.approx(lengths[0], rel=3 * clean.scale_std)


def test_a_missing_altitude_has_no_influence():
    """Half of the positions have none: their values are those of the origin, far below the others."""
    made = make(replace(SURVEY, position_std_m=(0.5, 0.5), points_in_view=15), 1)
    flat = [
        replace(p, w_p_b_m=p.w_p_b_m * [1, 1, 0] - [0, 0, 500.0 * k], std_m=np.array([*p.std_m[:2], np.inf]))
        if p.k % 2
        else p
        for k, p in enumerate(made.measurements.positions)
    ]
    found = refine(replace(made.measurements, positions=tuple(flat)), made.start, made.floor_z_m)
    assert found.noise.position_m[2] < 1.5
    off = found.w_T_b[:, :3, 3] - made.w_T_b[:, :3, 3]
    assert np.abs(off[:, 2]).max() < 2.0
    nowhere = tuple(replace(p, std_m=np.array([*p.std_m[:2], np.inf])) for p in made.measurements.positions)
    without = refine(replace(made.measurements, positions=nowhere), made.start, made.floor_z_m)
    assert without.floor_z_m == pytest.approx(made.floor_z_m, abs=1e-3)
    assert np.isfinite(without.covariances).all()
    assert np.sqrt(without.covariances[:, 5, 5].max()) < 20.0


@pytest.mark.slow
def test_attitude_errors_of_degrees_do_not_distort_the_map():
    scene, outcome = replace(SONAR, attitude_std_rad=0.005), []
    for seed in SEEDS:
        made = make(scene, seed)
        with_wrong = refine(misled(made, 0.005), made.start)
        without = refine(replace(made.measurements, attitudes=()), made.start)
        hat = aligned(with_wrong.w_T_b, made.w_T_b)
        cosine = np.sum(hat[:, 2, :3] * made.w_T_b[:, 2, :3], axis=1)
        outcome.append(
            [
                position_rms(made, with_wrong.w_T_b),
                position_rms(made, without.w_T_b),
                np.degrees(np.arccos(np.clip(cosine, -1, 1))).max(),
                errors_squared(made, with_wrong).mean(),
                with_wrong.noise.roll_pitch_rad,
            ]
        )
    wrong_rms, without_rms, tilt_deg, consistency, level_rad = np.mean(outcome, axis=0)
    assert wrong_rms < 1.1 * without_rms
    assert tilt_deg < 1.0
    assert 4.6 < consistency < 7.4
    assert 0.06 < level_rad < 0.5


@pytest.mark.parametrize("relief", [0.0, 0.05])
def test_the_flat_floor_does_not_shrink_the_map(relief: float):
    """Points pulled to the floor must not pull the scale: ranges alone make it, without bias.

    Were the map kept in metres, a smaller one would have less relief, and the prior would make it so.
    """
    scene = replace(
        SONAR, relief=relief, range_std_m=0.08, attitude_std_rad=None, points_in_view=60, keyframes=10
    )
    scale = []
    for seed in SEEDS:
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start)
        scale.append(np.log(bundle.w_T_b[:, 2, 3].mean() / made.w_T_b[:, 2, 3].mean()))
    of_ranges = 0.08 / 0.8 / np.sqrt(scene.keyframes)
    assert abs(np.mean(scale)) < 3 * of_ranges / np.sqrt(len(SEEDS))
    assert 0.5 * of_ranges < np.std(scale) < 1.6 * of_ranges


def test_a_sonar_that_reads_short_is_inside_the_covariance():
    """Gains of 4 % (one sigma): honest with the prior, far from it without."""
    honest, believed = [], []
    for seed in SEEDS:
        gain = 1 + 0.04 * np.random.default_rng(1000 + seed).normal()
        made = make(replace(SONAR, range_gain=gain, range_gain_std=0.04), seed)
        start = made.start
        honest.append(errors_squared(made, refine(made.measurements, start))[6])
        exact = replace(made.measurements, range_gain_std=0.0)
        believed.append(errors_squared(made, refine(exact, start))[6])
    lower, upper = chi2.ppf([0.001, 0.999], 6 * len(SEEDS)) / len(SEEDS)
    assert lower < np.mean(honest) < upper
    assert np.mean(believed) > 3 * upper


@pytest.mark.slow
def test_two_heights_separate_zero_and_scale_of_a_sonar():
    """Zero 3 cm off at 0.5 and 1.1 m: found, with an honest standard deviation; the map keeps its size."""
    scene = replace(
        SONAR, height_swing=0.4, range_gain_std=0.05, range_datum_m=0.03, range_datum_std_m=0.05, keyframes=20
    )
    off, length = [], []
    for seed in SEEDS:
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start)
        found = bundle.range_errors
        assert found is not None
        assert found.zero_std_m < 0.02
        off.append((found.zero_m - 0.03) / found.zero_std_m)
        length.append(bundle.w_T_b[:, 2, 3].mean() / made.w_T_b[:, 2, 3].mean() - 1.0)
    lower, upper = chi2.ppf([0.001, 0.999], len(SEEDS)) / len(SEEDS)
    assert lower < np.mean(np.square(off)) < upper
    assert np.abs(length).mean() < 0.02


def test_one_height_leaves_the_zero_of_a_sonar_at_its_prior():
    scene = replace(SONAR, height_swing=0.0, range_gain_std=0.05, range_datum_m=0.03, range_datum_std_m=0.05)
    made = make(scene, 0)
    found = refine(made.measurements, made.start).range_errors
    assert found is not None
    assert found.zero_std_m > 0.04
    assert found.gain_std > 0.04


def test_without_a_metric_measurement_the_initial_scale_is_kept():
    made = make(replace(SONAR, range_std_m=None), 0)
    bundle = refine(made.measurements, made.start)
    assert bundle.w_T_b[:, 2, 3].mean() == pytest.approx(made.start[:, 2, 3].mean(), rel=1e-4)
    # Shape right, size the start's: 3 % too large.
    assert bundle.w_T_b[-1, 0, 3] / bundle.w_T_b[-1, 2, 3] == pytest.approx(
        made.w_T_b[-1, 0, 3] / made.w_T_b[-1, 2, 3], abs=0.01
    )
    assert np.isfinite(bundle.covariances).all()


def test_outlier_observations_are_dropped_and_counted():
    found = []
    for seed in SEEDS:
        made, rng = make(SONAR, seed), np.random.default_rng(seed)
        tracks = made.measurements.tracks
        wild = rng.uniform(size=len(tracks.track)) < 0.05
        shift = rng.uniform(30, 90, (len(wild), 2)) * rng.choice([-1, 1], (len(wild), 2))
        pixel = tracks.pixel + wild[:, None] * shift
        bundle = refine(replace(made.measurements, tracks=replace(tracks, pixel=pixel)), made.start)
        # What is left of a point seen twice goes with the wild one.
        twice = np.bincount(tracks.track[~wild], minlength=tracks.track.max() + 1) < 2
        expected = wild.sum() + (twice[tracks.track] & ~wild).sum()
        clean = refine(made.measurements, made.start)
        found.append(
            [
                bundle.dropped_observations / expected,
                position_rms(made, bundle.w_T_b) / position_rms(made, clean.w_T_b),
                errors_squared(made, bundle).mean(),
                bundle.noise.pixel_scale,
            ]
        )
    dropped, rms_ratio, consistency, pixel_scale = np.mean(found, axis=0)
    # A wild one among three draws its point along: one of the others may go too.
    assert 0.97 < dropped < 1.25
    assert rms_ratio < 1.2
    assert 4.6 < consistency < 7.4
    assert pixel_scale == pytest.approx(1.0, rel=0.1)


def test_points_on_walls_do_not_bias_the_relief():
    """Points in the air (5 %, at a quarter of the height) are not taken for relief everywhere."""
    scene = replace(SONAR, relief=0.02, walls=0.05)
    found = [refine(m.measurements, m.start).noise.relief for m in (make(scene, seed) for seed in SEEDS)]
    assert np.mean(found) == pytest.approx(0.02, rel=0.25)


def test_the_same_input_gives_the_same_bits():
    made = make(SONAR, 3)
    one, again = (refine(made.measurements, made.start) for _ in range(2))
    assert one.w_T_b.tobytes() == again.w_T_b.tobytes()
    assert one.covariances.tobytes() == again.covariances.tobytes()
    assert one.noise.pixel_scale == again.noise.pixel_scale


def test_a_camera_below_the_floor_raises():
    made = make(SONAR, 0)
    start = made.start.copy()
    start[5, 2, 3] *= -1
    with pytest.raises(BackendError, match=r"keyframe 5|below the floor"):
        refine(made.measurements, start)


@pytest.mark.parametrize("free_lens", [False, True])
def test_points_behind_a_camera_cost_and_print_nothing(capfd: pytest.CaptureFixture[str], free_lens: bool):
    """Some factors of gtsam take them at no cost, and print a line for each."""
    made = make(SCENES["gps, camera unknown"], 0)
    measured = made.measurements
    problem = BundleProblem(measured, measured.tracks, measured.camera, BundleConfig(), free_lens)
    values = start_values(problem, made.start, made.floor_z_m)
    if free_lens:
        start_calibration(values, measured.camera)
    used = np.ones(len(measured.tracks.track), bool)
    graph = build_graph(problem, start_noise(measured, problem.config), used, values)
    before = graph.error(values)
    pose = values.atPose3(POSE(5))
    values.update(POSE(5), gtsam.Pose3(pose.rotation(), pose.translation() * [1, 1, -1]))
    assert graph.error(values) > 5 * before
    graph.linearize(values)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("missing", ["tracks", "camera"])
def test_missing_tracks_or_camera_raise(missing: str):
    made = make(SONAR, 0)
    with pytest.raises(BackendError, match="no tracks of floor points, or no camera"):
        refine(replace(made.measurements, **{missing: None}), made.start)


def test_the_scale_given_the_gain_of_the_ranges_is_more_certain():
    """The gain that all ranges share has a standard deviation of several per cent."""
    made = make(replace(SONAR, range_gain_std=0.05), 0)
    bundle = refine(made.measurements, made.start)
    assert bundle.scale_std > 0.5 * made.measurements.range_gain_std
    assert 0 < bundle.conditional_scale_std < 0.5 * bundle.scale_std


def test_the_slope_of_the_floor_is_no_error_over_the_floor():
    """Without positions the slope is fixed, and tilt errors are the same in the world and over the floor."""
    for scene, same in ((SONAR, True), (SCENES["gps over a slope"], False)):
        made = make(scene, 0)
        bundle = refine(made.measurements, made.start, made.floor_z_m)
        tilt, over_floor = bundle.covariances[:, :2, :2], bundle.over_floor_covariances[:, :2, :2]
        assert np.allclose(tilt, over_floor, rtol=1e-3, atol=1e-12) == same
