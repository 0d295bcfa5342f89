import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.dynamics import COMMAND
from slam.simulation.stick import Stick

STICK = Stick(
    np.array([0.0, 1.0, 1.013, 2.5]),
    np.array([[0, 0, 0, 0], [0.2, 0, 0, 0], [0.2, -0.1, 0, 0.3], [0, 0, -0.5, 0]], dtype=float),
    4.0,
)


def brute(begin, end, latency, count=200_000):
    t = begin + (np.arange(count) + 0.5) / count * (end - begin)
    return STICK.at(t, latency).mean(0)


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.5, 3.5), st.floats(0.001, 1.0), st.floats(0, 0.4))
def test_the_mean_is_that_of_many_samples(begin, length, latency):
    found = STICK.mean(np.array([begin]), np.array([begin + length]), latency)[0]
    assert found[:5] == pytest.approx(brute(begin, begin + length, latency)[:5], abs=2e-5)


def test_a_change_counts_from_its_stamp_on():
    before, at = STICK.at(np.array([0.999999, 1.0]))
    assert (before[0], before[4]) == (0.0, 1.0)
    assert (at[0], at[4]) == (0.2, 0.0)
    assert STICK.at(np.array([1.05]), 0.1)[0, 0] == 0.0
    assert not STICK.at(np.array([-3.0]))[0, :4].any()


def test_up_and_yaw_do_not_take_a_centred_stick_out_of_its_centre():
    assert STICK.at(np.array([3.0]))[0, COMMAND.index("centred")] == 1.0


def test_the_mean_is_smooth_in_the_latency():
    nodes = np.arange(0, 4, 0.002)
    forces = [STICK.mean(nodes[:-1], nodes[1:], T)[:, 0] for T in np.linspace(0.10, 0.11, 11)]
    change = np.diff(forces, axis=0)
    assert np.abs(np.diff(change.sum(1))).max() < 1e-9
    # A millisecond of the 2 ms step: half the change of the stick, not all or nothing.
    assert np.abs(change).max() == pytest.approx(0.1, rel=1e-6)


def test_discharge_is_the_share_of_the_flight():
    assert STICK.at(np.array([-1.0, 1.0, 4.0, 9.0]))[:, 5] == pytest.approx([0, 0.25, 1, 1])
