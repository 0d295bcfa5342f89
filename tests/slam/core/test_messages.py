"""Kinds of messages, and their sentences."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from slam.core.messages import Note, by_kind, is_note, reasons_of, same_kind, sentences, with_notes
from slam.core.summary import summarise
from slam.io.estimate import read_estimate, write_estimate
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from tests.slam.io.made_flight import made_flight
from tests.slam.made_estimate import made_estimate

WARNING, NOTE = (
    "sonar0: stuck; repair it",
    Note("times from the camera's clock; the map does not depend on it"),
)


def test_a_kind_survives_shortening_and_other_processes():
    assert by_kind([NOTE, WARNING]) == ((WARNING,), (NOTE,))
    assert is_note(same_kind(NOTE, "part: x"))
    assert not is_note(same_kind(WARNING, "part: x"))
    assert is_note(pickle.loads(pickle.dumps(NOTE)))
    assert [is_note(line) for line in with_notes([WARNING, str(NOTE)], [NOTE])] == [False, True]


def test_a_kind_survives_the_files_of_a_map(tmp_path):
    estimate = replace(made_estimate(), warnings=(WARNING, NOTE))
    write_estimate(estimate, tmp_path)
    found = read_estimate(tmp_path)
    assert found.warnings == estimate.warnings
    assert [is_note(line) for line in found.warnings] == [False, True]
    record = summarise(found).to_json()
    assert record["warnings"] == [WARNING, NOTE]
    assert record["notes"] == [NOTE]


def test_a_kind_survives_the_files_of_a_flight(tmp_path):
    write_flight(replace(made_flight(), warnings=(WARNING, NOTE)), tmp_path / "flight")
    found = read_flight(tmp_path / "flight").warnings
    assert {line: is_note(line) for line in found if line in (WARNING, NOTE)} == {WARNING: False, NOTE: True}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "gps0: off; it moves poses (5 m; 2 sigmas); check it",
            "gps0: off. It moves poses (5 m; 2 sigmas). Check it.",
        ),
        ("cam0: did it freeze? What it passed is missing", "cam0: did it freeze? What it passed is missing."),
        ("is the sensor stuck?", "is the sensor stuck?"),
        ("x; sensor.yaml lacks noise_std", "x. sensor.yaml lacks noise_std."),
        ("", ""),
    ],
)
def test_clauses_become_sentences(line, said):
    assert sentences(line) == said


def test_the_reasons_of_a_status_are_found_among_the_messages():
    """A reason may hold semicolons itself, and another message may be a part of it."""
    first, second = "gps0: off; it moves poses; check it", "the map is in 2 parts"
    lines = ("off; it moves", second, "other", first)
    assert reasons_of(f"{first}; {second}", lines) == (first, second)
    assert reasons_of("ok", lines) == ()
    assert reasons_of(f"{first}; unknown", lines) == (f"{first}; unknown",)
