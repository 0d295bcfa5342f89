"""Of two motions in a pair of pictures the floor's is taken, though the other has more matches."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.homography import transfer
from frontend.motions import DISTINCT_MOTION_WIDTHS, MOST_LEAD, Expectation, FloorMotion, floor_motion
from frontend.points import Points

SIZE = (320, 240)
CORNERS = np.array([[-0.5, -0.5], [319.5, -0.5], [319.5, 239.5], [-0.5, 239.5]])
FLOOR = np.array([[1.0, 0.02, 25.0], [-0.02, 1.0, -8.0], [0.0, 0.0, 1.0]])


def matches(rng, floor: int, other: int, other_H, noise_px=0.2, wrong=0):
    """Floor points all over the picture but its left third, others there; some matches are wrong."""
    on_floor = rng.uniform([110, 0], [320, 240], (floor, 2))
    beside = rng.uniform([0, 0], [105, 240], (other, 2))
    astray = rng.uniform([0, 0], [320, 240], (wrong, 2))
    j = np.vstack([on_floor, beside, astray])
    i = np.vstack([transfer(FLOOR, on_floor), transfer(other_H, beside), rng.uniform(0, 240, (wrong, 2))])
    order = rng.permutation(len(j))
    i, j = i + rng.normal(0, noise_px, i.shape), j + rng.normal(0, noise_px, j.shape)
    return i[order], j[order]


def floor_of(i: np.ndarray, j: np.ndarray, expected: Expectation | None = None) -> FloorMotion | None:
    """Of matched pixels, each as surely known as the other."""
    return floor_motion(Points.alike(i), Points.alike(j), j, CORNERS, SIZE, expected=expected)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shift", [(0.0, 0.0), (-30.0, 12.0)])
def test_the_floor_wins_with_a_third_of_the_matches(seed, shift):
    other = np.eye(3)
    other[:2, 2] = shift
    i, j = matches(np.random.default_rng(seed), 100, 200, other, wrong=30)
    found = floor_of(i, j)
    assert found is not None
    off = transfer(found.fit.i_H_j, CORNERS) - transfer(FLOOR, CORNERS)
    assert np.abs(off).max() < 1.5
    assert found.elsewhere.sum() > 180
    assert not (found.elsewhere & found.fit.inlier).any()
    assert found.other_i_H_j is not None
    beside = np.array([[5.0, 5.0], [100.0, 5.0], [100.0, 230.0], [5.0, 230.0]])
    np.testing.assert_allclose(transfer(found.other_i_H_j, beside), transfer(other, beside), atol=3.0)


@pytest.mark.parametrize("wrong", [0, 60])
def test_a_floor_alone_has_no_other_motion(wrong):
    rng = np.random.default_rng(7)
    i, j = matches(rng, 200, 100, FLOOR, wrong=wrong)
    found = floor_of(i, j)
    assert found is not None
    assert not found.elsewhere.any()
    assert found.other_i_H_j is None
    assert found.fit.inlier.sum() > 290


def test_nothing_that_agrees_is_none():
    rng = np.random.default_rng(1)
    i, j = rng.uniform(0, 240, (2, 3, 2))
    assert floor_of(i, j) is None


def shifted(x: float, y: float) -> np.ndarray:
    H = np.eye(3)
    H[:2, 2] = x, y
    return H


def expecting(H: np.ndarray, lead: float) -> Expectation:
    return Expectation(transfer(H, CORNERS), lead)


@pytest.mark.parametrize("seed", range(3))
def test_what_continues_is_the_floor_until_the_other_has_filled_more_for_long(seed):
    """Here the other fills two thirds of the picture, and a floor is expected in the third."""
    third = shifted(60.0, 0.0)
    i, j = matches(np.random.default_rng(seed), 200, 60, third)
    lead, told = 1.0, []
    for _ in range(8):
        found = floor_motion(
            Points.alike(i), Points.alike(j), j, CORNERS, SIZE, expected=expecting(third, lead)
        )
        assert found is not None
        told.append(np.abs(transfer(found.fit.i_H_j, CORNERS) - transfer(FLOOR, CORNERS)).max() < 3.0)
        lead = found.lead if not told[-1] else lead
    assert not told[0]
    assert told[-1]
    assert sorted(told) == told


def test_a_picture_that_comes_as_expected_is_taken_with_the_fewer_matches():
    """A floor that repeats: two thirds of the matches are with the wrong copy, one period away."""
    rng = np.random.default_rng(0)
    j = rng.uniform([0, 0], SIZE, (150, 2))
    right, wrong = shifted(30.0, 5.0), shifted(-70.0, 5.0)
    copies = np.arange(150) % 3 > 0
    i = np.where(copies[:, None], transfer(wrong, j), transfer(right, j)) + rng.normal(0, 0.2, j.shape)
    alone = floor_of(i, j)
    found = floor_motion(
        Points.alike(i), Points.alike(j), j, CORNERS, SIZE, expected=expecting(shifted(27.0, 3.0), 2.0)
    )
    assert alone is not None
    assert found is not None
    assert transfer(alone.fit.i_H_j, CORNERS) == pytest.approx(transfer(wrong, CORNERS), abs=2.0)
    assert transfer(found.fit.i_H_j, CORNERS) == pytest.approx(transfer(right, CORNERS), abs=2.0)


def test_a_jump_is_believed_where_nothing_lies_as_expected():
    i, j = matches(np.random.default_rng(3), 200, 100, FLOOR, wrong=30)
    found = floor_motion(
        Points.alike(i),
        Points.alike(j),
        j,
        CORNERS,
        SIZE,
        expected=expecting(shifted(-3 * DISTINCT_MOTION_WIDTHS * SIZE[0], 0), 2.0),
    )
    assert found is not None
    assert transfer(found.fit.i_H_j, CORNERS) == pytest.approx(transfer(FLOOR, CORNERS), abs=1.0)


@pytest.mark.parametrize("apart_px", [6.0, 9.0])
def test_two_motions_a_little_apart_are_not_blended(apart_px):
    other = FLOOR.copy()
    other[0, 2] -= apart_px
    i, j = matches(np.random.default_rng(4), 100, 130, other, noise_px=0.05)
    found = floor_of(i, j)
    assert found is not None
    assert found.fit.noise_px < 0.2
    assert transfer(found.fit.i_H_j, CORNERS) == pytest.approx(transfer(FLOOR, CORNERS), abs=1.0)


def test_the_lead_does_not_grow_beyond_its_limit():
    i, j = matches(np.random.default_rng(3), 100, 200, shifted(-30.0, 12.0))
    found = floor_of(i, j, expecting(FLOOR, MOST_LEAD))
    assert found is not None
    assert found.other_i_H_j is not None
    assert found.lead == MOST_LEAD


def test_the_other_motion_is_told_by_its_share_and_both_displacements():
    i, j = matches(np.random.default_rng(3), 100, 200, shifted(-30.0, 12.0), noise_px=0.0)
    found = floor_of(i, j, expecting(FLOOR, MOST_LEAD))
    assert found is not None
    other = found.other(j, SIZE)
    assert other is not None
    assert other.share == pytest.approx(1 / 3, abs=0.06)  # the left third of the picture
    assert other.moved_px == pytest.approx((-30.0, 12.0), abs=0.1)
    on_other = j[j[:, 0] < 107]
    assert other.floor_px == pytest.approx((transfer(FLOOR, on_other) - on_other).mean(axis=0), abs=0.1)
    middle = np.array([[160.0, 120.0]])
    assert other.middle_px == pytest.approx((transfer(FLOOR, middle) - middle)[0], abs=0.1)
