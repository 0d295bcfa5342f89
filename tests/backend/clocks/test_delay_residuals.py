"""Costs of the delays of one stream behind another."""

from __future__ import annotations

import tracemalloc

import numpy as np

from backend.clocks.delay_residuals import DelayResiduals, mean_square, turn_costs


def residuals(turns: int, delays: int) -> DelayResiduals:
    rng = np.random.default_rng(0)
    begin_s = 0.3 * np.arange(turns)
    difference = rng.normal(0, 1e-3, (turns, delays, 3))
    return DelayResiduals(
        np.linspace(-1, 1, delays), begin_s, begin_s + 0.3, rng.normal(size=(turns, 3)), difference
    )


def test_costs_of_turns_are_those_of_gaussian_noise_on_each_axis() -> None:
    squares = residuals(50, 9).squares
    variance = squares.mean(axis=1)
    expected = sum(squares[axis] / variance[axis] + np.log(variance[axis]) for axis in range(3))
    np.testing.assert_allclose(turn_costs(squares), expected, rtol=1e-12)
    np.testing.assert_allclose(mean_square(squares), variance)


def test_costs_of_turns_take_memory_of_one_axis_beside_the_squares() -> None:
    made = residuals(400, 300)
    size = made.difference.nbytes
    assert made.ratios  # estimated before, on a coarser grid
    tracemalloc.start()
    turn_costs(made.squares)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5 * size
