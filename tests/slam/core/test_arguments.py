"""Wrong arguments of the public functions are refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

import slam
from slam.core.flight import Flight

FLIGHT = Flight("one")
PATH = Path("flights/one")
READ_IT = r"flight: expected Flight, got the path 'flights/one'; read it first: slam.read_flight\(path\)"


@pytest.mark.parametrize("path", [PATH, str(PATH)])
@pytest.mark.parametrize(
    "call",
    [slam.optimize, slam.navigate, slam.evaluate_loops],
    ids=lambda call: call.__name__,
)
def test_a_path_for_a_flight_is_refused_with_the_remedy(call, path):
    with pytest.raises(TypeError, match=f"^{READ_IT}$"):
        call(path)


def test_other_types_for_a_flight_are_named():
    with pytest.raises(TypeError, match=r"^flight: expected Flight, got NoneType$"):
        slam.optimize(None)


@pytest.mark.parametrize("call", [slam.evaluate, slam.Relocalizer])
def test_a_path_for_an_estimate_is_refused_with_the_remedy(call):
    with pytest.raises(TypeError, match=r"^estimate: .*read it first: slam.read_estimate\(folder\)$"):
        call(PATH, FLIGHT)


@pytest.mark.parametrize("call", [slam.criticise, slam.join_flights])
@pytest.mark.parametrize(
    ("flights", "message"),
    [
        (PATH, "flights: expected an iterable of Flight, got the path 'flights/one'"),
        (str(PATH), "flights: expected an iterable of Flight, got the path 'flights/one'"),
        (FLIGHT, "flights: expected several flights, got one Flight; put it into a list"),
        (3, "flights: expected an iterable of Flight, got int"),
        ([FLIGHT, PATH], r"flights\[1\]: expected Flight, got the path"),
    ],
)
def test_what_is_no_list_of_flights_is_refused(call, flights, message):
    with pytest.raises(TypeError, match=f"^{message}"):
        call(flights)


@pytest.mark.parametrize(
    ("write", "expected"), [(slam.write_flight, "Flight"), (slam.write_estimate, "Estimate")]
)
def test_another_object_is_not_written(write, expected, tmp_path):
    with pytest.raises(TypeError, match=f"expected {expected}, got int"):
        write(3, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_flights_may_come_from_a_generator():
    assert slam.join_flights(flight for flight in [FLIGHT]) is FLIGHT
    listed = slam.criticise([FLIGHT])
    assert (
        slam.criticise(flight for flight in [FLIGHT]).sentence
        == listed.sentence
        != slam.criticise([]).sentence
    )
