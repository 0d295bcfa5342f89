"""The whole job on photographs: no order, no stamps of use, perhaps nothing that ties them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.core.streams import Frames
from slam.core.summary import summarise
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import elsewhere, flown, only, photographs
from tests.slam.whole_job import assert_whole, refusal


def test_photographs_without_gps_are_placed_in_any_order():
    flight = flown(0)
    order = np.random.default_rng(1).permutation(np.arange(0, 98, 4))
    estimate = optimize(photographs([(flight, int(k)) for k in order]))
    assert len(estimate.stamps_s) == 25
    assert_whole(estimate)
    assert "no metric scale" in estimate.status
    there = np.array(
        [
            [
                np.interp(flight.frames.stamps_s[k], flight.truth.stamps_s, flight.truth.w_T_b[:, a, 3])
                for a in (0, 1)
            ]
            for k in order
        ]
    )
    # The same picture up to a similarity of the plane: complex numbers, Horn's fit.
    a, b = estimate.w_T_b[:, :2, 3] @ [1, 1j], there @ [1, 1j]
    a, b = a - a.mean(), b - b.mean()
    left = b - a * np.vdot(a, b) / np.vdot(a, a)
    assert np.sqrt(np.mean(np.abs(left) ** 2)) < 2e-3


@pytest.mark.parametrize("mixed", [pytest.param("one after the other", marks=pytest.mark.slow), "in turns"])
def test_photographs_of_two_places_are_two_parts(mixed):
    """In turns no picture overlaps the one before: only looking at all pairs finds who belongs together."""
    here, there = flown(0), elsewhere()
    photos = [(here, 3 * k) for k in range(12)] + [(there, 3 * k) for k in range(9)]
    if mixed == "in turns":
        photos = [pair for k in range(9) for pair in ((here, 3 * k), (there, 3 * k))] + photos[9:12]
    estimate = optimize(photographs(photos))
    belongs = np.array([0 if flight is here else 1 for flight, _ in photos])
    assert np.array_equal(estimate.component, belongs)
    assert "2 parts (12, 9 keyframes) that no overlapping pictures connect" in estimate.status
    assert "look at the smaller part: " in estimate.status
    first = next(name for name, of in zip(estimate.frame_names, belongs, strict=True) if of)
    assert f"part: {first}, " in estimate.status


def test_photographs_that_are_not_placed_are_named(capfd):
    """One belongs to nothing, one shows nothing, and one cannot be read."""
    here, there = flown(0), elsewhere()
    flight = photographs([(here, 3 * k) for k in range(10)] + [(there, 0)])
    frames, names = flight.frames, flight.frames.names
    odd = {4: np.full(frames.load(0).shape, 90, np.uint8), 6: None}

    def load(k):
        return odd[k] if k in odd else frames.load(k)

    estimate = optimize(replace(flight, frames=Frames(frames.stamps_s, names, load, {6: "truncated"})))
    assert estimate.not_placed == {
        names[4]: "too few features",
        names[6]: "unreadable: truncated",
        names[10]: "could not be joined to any other picture",
    }
    assert summarise(estimate).to_json()["not_placed"] == estimate.not_placed
    assert f"not on the map ({names[10]})" in estimate.status
    for k, reason in ((4, "too few features"), (6, "unreadable: truncated")):
        assert f"1 photograph not placed: {reason} ({names[k]})" in estimate.warnings
    assert capfd.readouterr() == ("", "")  # nothing of the libraries reaches the terminal


@pytest.mark.slow
def test_a_photograph_that_belongs_to_nothing_is_left_out():
    here, there = flown(0), elsewhere()
    flight = photographs([(here, 3 * k) for k in range(8)] + [(there, 0)])
    estimate = optimize(flight)
    assert estimate.component.tolist() == [0] * 8 + [-1]
    assert np.isnan(estimate.w_T_b[8]).all()
    assert np.isnan(estimate.covariances[8]).all()
    assert "1 keyframe could not be joined to any other picture: not on the map" in estimate.status
    with_sonar = optimize(replace(flight, sonar=replace(here.sonar, stamps_s=here.sonar.stamps_s * 1.1)))
    assert "no metric scale" not in with_sonar.status


def test_photographs_that_do_not_overlap_are_refused():
    message = refusal(photographs([(flown(0), 0), (elsewhere(), 0)]))
    assert re.search(r"no two of 2 pictures could be joined \(1 x [a-z ]+\)", message)


def test_two_photographs_alone_converge():
    """Their robust cost is flat: thirty steps were too few, and the advice named a height sensor."""
    assert "converge" not in optimize(only(flown(0), [50, 51])).status
