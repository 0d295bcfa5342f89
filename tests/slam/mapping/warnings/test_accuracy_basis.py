"""The sentence about the single instrument that determines a stated accuracy."""

from types import SimpleNamespace

import numpy as np
import pytest

from backend.bundle.lens import LensEstimate
from backend.pose_graph.solution import RangeErrors
from slam.mapping.warnings.accuracy_basis import accuracy_basis

SHARED = ("scale_std", "datum_std")


def basis(
    sonar=False,
    gps=False,
    accelerometer=False,
    velocity=False,
    barometer=False,
    gain_std=0.05,
    zero_std_m=0.02,
    focal_std_ratio=0.01,
    assumed=SHARED,
    lens=None,
    shares=None,
    control=None,
):
    errors = RangeErrors(1.0, gain_std, 0.0, zero_std_m) if sonar else None
    measured = SimpleNamespace(positions=("fix",) if gps else (), control=())
    map_ = SimpleNamespace(
        bundle=SimpleNamespace(
            range_errors=errors,
            lens=lens,
            uses_reported_motion=velocity,
            uses_barometer=barometer,
            optimum=SimpleNamespace(problem=SimpleNamespace(measurements=measured)),
        ),
        georeferenced=gps,
        control=control,
        camera=SimpleNamespace(focal_std_ratio=focal_std_ratio),
        inertial=SimpleNamespace(helps=True) if accelerometer else None,
    )
    readings = SimpleNamespace(scale_std=0.05, datum_std_m=0.02, assumed=assumed)
    return accuracy_basis(SimpleNamespace(sonar=readings if sonar else None), map_, {"scale": shares or {}})


def test_the_only_instrument_is_named():
    assert basis(gps=True).startswith("Place, lengths and their accuracy rest on one GPS receiver alone")
    assert basis(accelerometer=True).startswith("Lengths and their accuracy rest on one accelerometer alone")
    assert basis(velocity=True).startswith(
        "Lengths and their accuracy rest on the vehicle's own velocity alone"
    )
    assert basis(barometer=True).startswith("Lengths and their accuracy rest on one barometer alone")
    assert "one height sensor alone" in basis(sonar=True, velocity=True)


def test_check_points_are_a_second_instrument():
    assert "one GPS receiver alone" in basis(gps=True, control=SimpleNamespace(checks=("P",)))
    assert basis(gps=True, control=SimpleNamespace(checks=("P", "Q"))) == ""


def test_an_instrument_of_little_weight_checks_none() -> None:
    light = {"velocity": 0.4, "barometer": 0.002, "pictures": 0.598}
    assert "the vehicle's own velocity alone" in basis(velocity=True, barometer=True, shares=light)
    assert basis(velocity=True, barometer=True, shares={"velocity": 0.4, "barometer": 0.1}) == ""
    assert basis(gps=True, accelerometer=True, shares={"imu": 0.9, "position": 0.001}) == ""


@pytest.mark.parametrize("used", [(), ("sonar", "gps"), ("gps", "accelerometer")])
def test_nothing_is_stated_without_an_instrument_or_with_two(used):
    assert basis(**dict.fromkeys(used, True)) == ""


@pytest.mark.parametrize(
    ("gain_std", "zero_std_m", "assumed"),
    [
        (0.05, 0.02, ", and its gain (± 5 %) and its zero (± 20 mm) are assumed."),
        (0.02, 0.019, ", and its zero (± 20 mm) is assumed."),
        (0.02, 0.01, "; no second instrument checks them."),
    ],
)
def test_values_that_the_flight_does_not_determine_are_assumed(gain_std, zero_std_m, assumed):
    advice = " Measure one distance on the ground to check the lengths."
    assert basis(sonar=True, gain_std=gain_std, zero_std_m=zero_std_m).endswith(assumed + advice)
    stated = basis(sonar=True, gain_std=gain_std, zero_std_m=zero_std_m, assumed=())
    assert stated.endswith(assumed.replace("assumed", "as stated") + advice)


def test_a_focal_length_that_is_held_is_named():
    assert ", and the camera's focal length is taken as exact." in basis(
        sonar=True, gain_std=0.02, zero_std_m=0.01, focal_std_ratio=0.0
    )


@pytest.mark.parametrize(
    ("lens", "told"),
    [(None, "taken as exact"), ((5.0, 5.0), "known to 0.5 % beforehand"), ((5.0, 3.0), "")],
)
def test_a_focal_length_behind_heights_is_named_where_the_flight_does_not_tell_it(lens, told):
    if lens is not None:
        stated_px, found_px = lens
        std = np.full(9, found_px)
        lens = LensEstimate("brown", np.full(9, 1000.0), std, np.full(9, stated_px))
    line = basis(gps=True, lens=lens).replace("\N{NO-BREAK SPACE}", " ")
    assert (f"heights over the ground rest on the focal length, {told}, which this" in line) == bool(told)
    assert ("focal" in line) == bool(told)
    assert "focal" not in basis(sonar=True, lens=lens)
