"""The clock of the pictures: found where the gyro shows it, with an honest deviation, and never invented."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend.clocks.delay_residuals import DelayResiduals
from backend.clocks.picture_clock import (
    LEAST_TURNS,
    ClockPiece,
    PictureClock,
    clock_of,
    picture_clock,
)
from backend.measurements import InertialReadings

IMU_S, PICTURE_S = 0.005, 0.2
CALM_RAD = np.radians([0.3, 0.3, 1.0])


def found(
    seed: int,
    delay_s: float = 0.0,
    step_s: float = 0.0,
    size_rad: np.ndarray = CALM_RAD,
    hertz: tuple[float, float] = (0.1, 1.0),
    gain: float = 1.0,
    lasts_s: float = 40.0,
    broken: int = 1,
) -> PictureClock | None:
    """Return the clock of a made flight that sways; its pictures are stamped late by ``delay_s``, and by
    ``step_s`` more from the second half on. Their attitudes are known to a milliradian, and from one of
    ``broken`` chains to the next not at all."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(*hertz, (6, 3, 1)), rng.uniform(0, 2 * np.pi, (6, 3, 1))

    def attitude(at_s: np.ndarray) -> Rotation:
        waves = np.sin(2 * np.pi * frequency * at_s + phase).sum(axis=0).T / np.sqrt(3)
        return Rotation.from_euler("xyz", size_rad * waves)

    imu_s = np.arange(-1.0, lasts_s + 1.0, IMU_S)
    rate = (attitude(imu_s).inv() * attitude(imu_s + 1e-5)).as_rotvec() / 1e-5
    noise = rng.normal(0.0, 1.5e-3 / np.sqrt(IMU_S), rate.shape)
    gyro = gain * rate + [0.01, -0.02, 0.01] + noise
    seen_s = np.arange(0.0, lasts_s, PICTURE_S)
    seen = attitude(seen_s) * Rotation.from_rotvec(rng.normal(0.0, 1e-3, (len(seen_s), 3)))
    chain = np.arange(len(seen_s)) * broken // len(seen_s)
    seen = Rotation.random(broken, random_state=seed)[chain] * seen if broken > 1 else seen
    stamps_s = seen_s + delay_s + np.where(seen_s >= lasts_s / 2, step_s, 0.0)
    return picture_clock(
        stamps_s, seen.as_matrix(), chain, InertialReadings(imu_s, gyro, np.zeros_like(gyro))
    )


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.1])
def test_the_delay_of_calm_flights_is_found_with_an_honest_deviation(delay_s: float):
    clocks = [found(seed, delay_s) for seed in range(6)]
    assert all(len(clock.pieces) == 1 and clock.pieces[0].known for clock in clocks)
    off = np.array([(clock.pieces[0].delay_s - delay_s) / clock.pieces[0].std_s for clock in clocks])
    assert chi2.ppf(1e-4, 6) < (off**2).sum() < chi2.ppf(1 - 1e-4, 6)
    assert np.abs(off).max() < 3
    assert all(clock.pieces[0].differs(0.0) == (delay_s > 0) for clock in clocks)


@pytest.mark.parametrize(
    "step_s", [pytest.param(1.0, marks=pytest.mark.slow), -0.15, pytest.param(5.0, marks=pytest.mark.slow)]
)
def test_a_step_of_the_clock_is_found_with_its_time(step_s: float):
    clock = found(1, 0.03, step_s)
    before, after = clock.pieces
    assert before.delay_s == pytest.approx(0.03, abs=4 * before.std_s)
    assert after.delay_s == pytest.approx(0.03 + step_s, abs=4 * after.std_s)
    assert after.begin_s == pytest.approx(20.03 + step_s, abs=0.25)


@pytest.mark.parametrize("found_s", [6.5, 7.0, 8.5])
def test_a_step_forward_begins_where_no_picture_was_taken_as_long(found_s: float):
    """With few turns behind it, a step is found some pictures away from where it is."""
    stamps_s = np.concatenate([np.arange(0.0, 7.0, 0.125), np.arange(8.0, 12.0, 0.125)])
    pieces = (
        ClockPiece(float("-inf"), 0.0, 0.001),
        ClockPiece(found_s, 1.0, 0.001, after_s=found_s - 0.25),
    )
    clock = PictureClock(pieces, 2.0).begun_at_pictures(stamps_s)
    assert clock.pieces[1].begin_s == 8.0
    assert (np.diff(stamps_s - clock.delays_at(stamps_s)) > 0).all()


@pytest.mark.parametrize("turns", range(2 * LEAST_TURNS, 2 * LEAST_TURNS + 4))
def test_the_fewest_turns_that_a_step_divides_are_enough(turns: int):
    delays_s, begin_s = np.linspace(-0.5, 0.5, 101), 0.2 * np.arange(turns)
    rng = np.random.default_rng(turns)
    turn_rad = rng.normal(0, 0.1, (turns, 3))
    off_rad = rng.normal(0, 1e-3, (turns, 1, 3)) + (delays_s - 0.1)[:, None] * turn_rad[:, None] / 0.2
    clock = clock_of(DelayResiduals(delays_s, begin_s, begin_s + 0.2, turn_rad, off_rad))
    assert clock is not None
    assert len(clock.pieces) == 1


def test_a_delay_is_known_across_chains_that_no_picture_links():
    (piece,) = found(2, 0.1, broken=5).pieces
    assert piece.known
    assert piece.delay_s == pytest.approx(0.1, abs=4 * piece.std_s)


def test_several_delays_that_explain_the_turns_as_well_leave_it_vague():
    """The likelihood of a motion with one period has a minimum at each, as sharp as the true one."""
    (piece,) = found(3, hertz=(1.0, 1.0), size_rad=10 * CALM_RAD).pieces
    assert not piece.known
    assert not piece.differs(0.0)


def test_a_vehicle_that_does_not_turn_shows_no_delay():
    clock = found(4, 0.1, size_rad=np.zeros(3))
    assert clock is None or not any(piece.known or piece.differs(0.0) for piece in clock.pieces)


@pytest.mark.parametrize("gain", [-1.0, np.degrees(1.0)])
def test_a_gyro_that_contradicts_the_pictures_tells_no_delay(gain: float):
    assert found(5, gain=gain) is None


def test_too_few_pictures_tell_nothing():
    assert found(6, lasts_s=2.0) is None
