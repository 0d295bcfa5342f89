"""``slam.criticise`` as a black box on folders of the blind generator: a few short cases (all: make blind)"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slam
from slam.criticism.search import expansion
from slam.criticism.search.effects import effects_for
from slam.io.flight_folder import read_flight
from tests.blind.cases import Case, make
from tests.blind.critic import flights_of
from tests.blind.folder import shifted
from tests.blind.score import FLAGS, Answer

FLIGHTS, SECONDS = 3, 16.0


@dataclass(frozen=True)
class Made:
    case: Case
    flights: list[Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory):
    """Cases by kind, seed and fault; each made once."""

    @cache
    def one(
        kind: str,
        seed: int,
        fault: str | None = None,
        d: float | None = None,
        flights: int = FLIGHTS,
        seconds: float = SECONDS,
    ) -> Made:
        home = tmp_path_factory.mktemp("case")
        case = make(kind, seed, 0, home, flights, seconds, fault, d)
        return Made(case, flights_of(home / case.name))

    return one


@pytest.fixture(scope="module")
def judged():
    @cache
    def one(*folders: Path) -> dict[str, Any]:
        found: dict[str, Any] = slam.criticise([read_flight(f) for f in folders]).to_json()
        return found

    return one


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("null", 11), ("null_edge", 12)])
def test_a_healthy_vehicle_is_called_healthy(kind, seed, made, judged):
    assert judged(*made(kind, seed, flights=2, seconds=12.0).flights)["verdict"] == "nothing_wrong"


@pytest.mark.parametrize(
    ("fault", "seed"),
    [
        pytest.param("steady_wind", 25, marks=pytest.mark.slow),
        pytest.param("sonar_tilt", 23, marks=pytest.mark.slow),
        pytest.param("control_latency", 21, marks=pytest.mark.slow),
        pytest.param("climb_asymmetry", 22, marks=pytest.mark.slow),
    ],
)
def test_a_single_cause_is_named(fault, seed, made, judged):
    case = made("single", seed, fault, 20.0)
    answer = Answer(case.case, judged(*case.flights))
    assert answer.right, (answer.word, answer.top, answer.equals)
    error, _ = answer.parameter(case.case.hidden[0])
    assert error < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "seed", "flights", "seconds"),
    # The load and the saturation look like a flow that reads too little, the level like a gyro that does.
    [
        ("iron_in_floor", 31, 2, 16.0),
        pytest.param("iron_in_floor", 31, FLIGHTS, SECONDS, marks=pytest.mark.slow),
        pytest.param("swinging_load", 32, FLIGHTS, SECONDS, marks=pytest.mark.slow),
        pytest.param("false_level", 33, FLIGHTS, SECONDS, marks=pytest.mark.slow),
        pytest.param("flow_saturation", 36, FLIGHTS, SECONDS, marks=pytest.mark.slow),
    ],
)
def test_what_no_term_explains_is_not_named(fault, seed, flights, seconds, made, judged):
    case = made("strange", seed, fault, 40.0, flights, seconds)
    answer = Answer(case.case, judged(*case.flights))
    assert answer.word in ("unknown", "named_with_remainder"), (answer.word, answer.top)
    assert answer.verdict["remainder"]


@pytest.mark.slow
def test_what_moves_in_the_pictures_is_named_and_dirt_on_the_lens_is_unknown(made, judged):
    moving = made("seen_single", 41, "moving_objects", flights=1)
    answer = Answer(moving.case, judged(*moving.flights))
    assert answer.right, (answer.word, answer.top, answer.verdict["remainder"])
    dirty = made("seen_strange", 42, "dirt_on_lens", flights=2)
    answer = Answer(dirty.case, judged(*dirty.flights))
    assert answer.word == "unknown", (answer.word, answer.top)
    assert "place in the picture" in answer.verdict["remainder"]


TWO_SHORT = ("single", 23, "sonar_tilt", 20.0, 2, 12.0)
WIND = ("single", 25, "steady_wind", 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("case", [TWO_SHORT, WIND], ids=lambda c: c[2])
def test_the_order_the_heading_and_the_hour_do_not_matter(case, made, judged, tmp_path):
    """Permuted flights in a turned world at another time: the same verdict, causes and sizes."""
    name, case = case[2], made(*case)
    moved = []
    for i, flight in enumerate(reversed(case.flights)):
        shifted(flight, tmp_path / f"flight_{i:02d}", seconds=86_400.0 + 7.0 * i, turn=2.2)
        moved.append(tmp_path / f"flight_{i:02d}")
    before, after = judged(*case.flights), judged(*moved)
    assert Answer(case.case, before).right
    assert after["verdict"] == before["verdict"]
    assert [c["name"] for c in after["causes"]] == [c["name"] for c in before["causes"]] == [name]
    for a, b in zip(after["causes"], before["causes"], strict=True):
        # A vector of the world turns with it: lengths are compared.
        sizes = [np.hypot.reduce([p["value"] for p in c["parameters"].values()]) for c in (a, b)]
        half = max(np.ptp(p["ci95"]) for p in b["parameters"].values()) / 2
        assert sizes[0] == pytest.approx(sizes[1], abs=0.3 * half)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "seed", "flights", "seconds"),
    [
        ("sonar_tilt", 23, 2, 12.0),
        pytest.param("steady_wind", 25, 4, 40.0, marks=pytest.mark.slow),
        pytest.param("climb_asymmetry", 22, 3, 16.0, marks=pytest.mark.slow),
    ],
)
def test_a_term_that_is_taken_out_of_the_catalogue_is_unknown_and_not_misnamed(
    fault, seed, flights, seconds, made, monkeypatch
):
    """Or a name is reported with what it leaves over: the flights separate the term from confounders."""
    case = made("single", seed, fault, 20.0, flights, seconds)

    def without(records: Any, setting: Any) -> list[Any]:
        return [effect for effect in effects_for(records, setting) if effect.name != fault]

    monkeypatch.setattr(expansion, "effects_for", without)
    found = slam.criticise([read_flight(f) for f in case.flights])
    assert fault not in {cause.name for cause in found.causes}
    assert found.verdict in FLAGS, found.sentence
    assert found.remainder
