import numpy as np
import pytest
from scipy.signal import lfilter

from backend.bundle.noise_level import least_std, redundancy_factor
from backend.bundle.refinement import refine
from backend.bundle.relief import STUDENT_SCALE
from backend.bundle.residual_spread import autocorrelated_std, huber_std
from tests.backend.made_floor import Scene, aligned, make, nees


def markov(rng: np.random.Generator, n: int, d: int, rho: float, std: float = 1.0) -> np.ndarray:
    """(n, d) first-order Markov series of a given standard deviation."""
    start = rng.normal(size=(1, d))
    drawn = np.sqrt(1 - rho**2) * rng.normal(size=(n, d))
    drawn[0] = start
    return std * lfilter([1.0], [1.0, -rho], drawn, axis=0)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.9])
@pytest.mark.parametrize("d", [1, 2])
def test_a_markov_series_is_worth_what_theory_says(rho, d):
    """Integrated autocorrelation (1 + rho) / (1 - rho)."""
    rng = np.random.default_rng(5)
    found = [autocorrelated_std(markov(rng, 600, d, rho, 0.3)) for _ in range(60)]
    assert np.mean(found) == pytest.approx(0.3 * np.sqrt((1 + rho) / (1 - rho)), rel=0.1)


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_taken_as_independent_it_gives_the_spread_that_the_mean_has(rho):
    """The oracle is the mean itself, drawn many times."""
    rng = np.random.default_rng(6)
    draws = [markov(rng, 300, 1, rho) for _ in range(1000)]
    claimed = np.mean([autocorrelated_std(x) for x in draws[:100]]) / np.sqrt(300)
    assert claimed == pytest.approx(np.std([x.mean() for x in draws]), rel=0.12)


def test_an_offset_counts_as_one_measurement():
    assert autocorrelated_std(np.full((100, 2), 0.4)) == pytest.approx(0.4 * np.sqrt(100), rel=0.02)


def test_no_error_at_all_is_no_spread():
    assert autocorrelated_std(np.zeros((50, 2))) == 0.0
    assert huber_std(np.zeros((50, 2)), 2.0) == 0.0


def test_few_values_are_taken_as_they_are():
    assert autocorrelated_std(np.array([[3.0], [-3.0]])) == pytest.approx(3.0)


@pytest.mark.parametrize("k", [1.345, 2.0, 3.0])
def test_gaussian_residuals_have_their_own_spread(k):
    x = np.random.default_rng(1).normal(0, 0.7, (20_000, 2))
    assert huber_std(x, k) == pytest.approx(0.7, rel=0.02)
    assert huber_std(100 * x, k) == pytest.approx(100 * huber_std(x, k), rel=1e-9)


def test_a_tenth_of_wild_residuals_raises_it_a_little():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(20_000, 2))
    x[:2000] *= 100
    assert 1.05 < huber_std(x, 2.0) < 1.3


def test_heavy_tails_count_for_more_than_the_median_sees():
    """Student's t with 3 degrees of freedom: between the spread of its core and its standard deviation."""
    x = np.random.default_rng(3).standard_t(3, (50_000, 2))
    core = np.median(np.linalg.norm(x, axis=1)) / 1.1774
    assert 1.03 * core < huber_std(x, 2.0) < 0.9 * np.sqrt(3)


def test_the_scale_of_the_student_fit_to_a_gaussian():
    x = np.random.default_rng(4).normal(size=1_000_000)
    assert np.mean(5 * x**2 / (4 * STUDENT_SCALE**2 + x**2)) == pytest.approx(1.0, abs=0.005)


def test_errors_that_last_along_a_track_widen_the_pixel_noise():
    """The poses then err by more than independent pixels would make them, and say so."""
    scene = Scene(pixel_colour=0.8, points_in_view=60, keyframes=20)
    consistency, scale = [], []
    for seed in range(12):
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start)
        hat = aligned(bundle.w_T_b, made.w_T_b)
        consistency.append(nees(hat[1:], made.w_T_b[1:], bundle.covariances[1:]).mean())
        scale.append(bundle.noise.pixel_scale)
    assert 4.0 < np.mean(consistency) < 8.5
    assert 0.6 < np.mean(scale) < 2.0


@pytest.mark.slow
def test_few_points_on_a_flat_floor_have_the_pixel_noise_that_was_put_in():
    """Neither heights that could follow the noise nor residuals that look alike by chance move its mean."""
    scale = [
        refine(made.measurements, made.start, made.floor_z_m).noise.pixel_scale
        for made in (make(Scene(keyframes=24, points_in_view=15), seed) for seed in range(40))
    ]
    assert np.mean(scale) == pytest.approx(1.0, abs=0.02)


def test_the_relief_is_found_over_a_wide_range():
    for relief in (0.003, 0.01, 0.06):
        scene = Scene(relief=relief, pixel_std=0.1, told_pixel_std=0.1, points_in_view=60)
        found = []
        for seed in range(6):
            made = make(scene, seed)
            found.append(refine(made.measurements, made.start).noise.relief)
        assert np.mean(found) == pytest.approx(relief, rel=0.2)


def test_the_noise_of_exact_positions_stays_what_the_pictures_can_show():
    """Positions without noise, of which pictures know each to 0.3 m: from round to round the fit follows them
    more, and its residuals shrink. The noise ends where it can no longer be told from zero."""
    count, pictures_m, rng = 40, 0.3, np.random.default_rng(3)
    off = rng.standard_normal(count)
    off *= pictures_m / np.sqrt(np.mean(off**2))  # as far off as the pictures alone explain
    for start in (0.01, 1.0):
        noise = start
        for _ in range(200):
            leverage = pictures_m**2 / (pictures_m**2 + noise**2)
            absorbed, residual = np.array([count * leverage]), off * (1 - leverage)
            found = np.sqrt(np.mean(residual**2)) * redundancy_factor(count, absorbed)
            noise = max(found, least_std(noise, count, absorbed))
        assert noise == pytest.approx(pictures_m * (2 / count) ** 0.25, rel=1e-6)


def test_few_absorbed_positions_have_no_least_noise():
    assert least_std(2.0, 200, np.array([4.0])) < 0.1 * 2.0
