import numpy as np
import pytest

from slam.simulation.hold_noise import HoldNoise, draw_noise

STEP = 0.002
NOISE = HoldNoise()
SIZES = np.array([np.radians(0.4)] * 2 + [np.radians(1.0)] + [0.034, 0.034, 0.012])


def drawn(seed, steps=1000, noise=NOISE, **options):
    return draw_noise(noise, steps, STEP, np.random.default_rng(seed), **options)


@pytest.mark.parametrize(
    "tau", [pytest.param(0.05, marks=pytest.mark.slow), 0.11, pytest.param(0.25, marks=pytest.mark.slow)]
)
def test_noise_is_stationary_from_the_first_node_on(tau):
    """Two-sided, over 3000 draws: 99.9 % of a ratio of standard deviations lies within 4.2 %."""
    noise = HoldNoise(velocity_correlation_s=tau)
    paths = np.stack([drawn(seed, 60, noise).values for seed in range(3000)])
    for node in (0, 1, 7, 60):
        assert paths[:, node, :6].std(0) == pytest.approx(SIZES, rel=0.045)
        assert np.abs(paths[:, node, :6].mean(0) / SIZES).max() < 4 / np.sqrt(3000)


def test_correlation_times_are_those_asked_for():
    values = drawn(1, 400_000).values
    for column, tau in ((0, 0.25), (1, 0.25), (2, 0.35)):
        x = values[:, column] / values[:, column].std()
        lag = round(tau / STEP)
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(np.exp(-1), abs=0.08)
    # Two poles in a row: (t1 e^-t/t1 - t2 e^-t/t2) / (t1 - t2), with 0.11 s and 0.02 s, at 0.11 s
    x = values[:, 3] / values[:, 3].std()
    lag = round(0.11 / STEP)
    expected = (0.11 * np.exp(-1) - 0.02 * np.exp(-0.11 / 0.02)) / 0.09
    assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(expected, abs=0.06)


def test_channels_are_independent():
    values = drawn(2, 200_000).values[:, :6]
    correlation = np.corrcoef(values.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.1


def test_the_rate_of_the_velocity_noise_is_its_derivative():
    path = drawn(3, 20_000)
    w, rate = path.values[:, 3:6], path.rates
    # Simpson would need the middle; the trapezoid's error is that of a kinked drive, 1/12 of its jumps.
    change = 0.5 * STEP * (rate[1:] + rate[:-1])
    assert np.abs(np.diff(w, axis=0) - change).max() < 0.03 * np.abs(np.diff(w, axis=0)).max()
    assert np.abs(w[0] + np.cumsum(change, axis=0) - w[1:]).max() < 0.05 * w.std()


def test_a_longer_noise_begins_like_a_shorter_one():
    assert np.array_equal(drawn(4, 50).values, drawn(4, 500).values[:51])


def test_gusts_have_their_own_numbers():
    calm, windy = drawn(5), drawn(5, gusts=(0.3, 2.0), gust_rng=np.random.default_rng(9))
    assert np.array_equal(calm.values[:, :6], windy.values[:, :6])
    assert not calm.values[:, 6:].any()
    many = [
        drawn(5, 10, gusts=(0.3, 2.0), gust_rng=np.random.default_rng(s)).values[5, 6:] for s in range(2000)
    ]
    assert np.std(many) == pytest.approx(0.3, rel=0.06)
