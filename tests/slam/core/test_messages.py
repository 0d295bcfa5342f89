"""Messages: their kinds, what they are about, and their sentences."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from slam.core.messages import (
    Kind,
    Message,
    about,
    by_kind,
    clauses_of,
    joined,
    note,
    parsed,
    reason,
    warning,
)
from slam.core.summary import summarise
from slam.io.estimate import read_estimate, write_estimate
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from tests.slam.io.made_flight import made_flight
from tests.slam.made_estimate import made_estimate

WARNING = about("sonar0", "stuck: no echo", "repair it")
NOTE = note("times from the camera's clock", "the map does not depend on it")
REASON = reason("the map is in 2 parts", "fly again")


def test_a_message_keeps_its_kind_and_what_it_is_about_when_its_text_changes():
    of_part = warning("part: sonar0: stuck: no echo", "repair it").concerning("sonar0")
    assert WARNING.after("part") == of_part
    assert WARNING.prefixed("then").text == "then sonar0: stuck: no echo; repair it"
    assert NOTE.extended("x").kind is Kind.NOTE
    assert pickle.loads(pickle.dumps(NOTE)) == NOTE


def test_a_message_has_its_finding_and_the_next_step():
    for message in (WARNING, WARNING.after("part")):
        assert (message.finding, message.verdict) == ("stuck: no echo", "stuck")
        assert message.next_step == "repair it"
        assert message.begins_with_colon
    leans = warning("attitude0 leans (5°; 2 sigmas)").concerning("attitude0")
    assert (leans.finding, leans.next_step) == ("leans (5°; 2 sigmas)", "")
    assert not leans.begins_with_colon


def test_the_status_is_made_of_the_reasons():
    """A text that is a reason and a message of the flight too stands once, among the reasons."""
    messages = joined(warning("other"), NOTE, WARNING.as_reason(), REASON, WARNING, warning(""), None)
    assert messages == (WARNING.as_reason(), REASON, warning("other"), NOTE)
    assert by_kind(messages).status == f"{WARNING}; {REASON}"
    assert by_kind((NOTE, WARNING)).status == "ok"


def test_messages_survive_the_files_of_a_map(tmp_path):
    estimate = replace(made_estimate(), messages=(REASON, WARNING, NOTE))
    write_estimate(estimate, tmp_path)
    found = read_estimate(tmp_path)
    assert found.messages == estimate.messages
    record = summarise(found).to_json()
    assert record["status"] == REASON.text
    assert record["warnings"] == [REASON.text, WARNING.text, NOTE.text]
    assert record["notes"] == [NOTE.text]


def test_messages_survive_the_files_of_a_flight(tmp_path):
    write_flight(made_flight().with_warning(WARNING, NOTE), tmp_path / "flight")
    found = {message.text: message for message in read_flight(tmp_path / "flight").messages}
    assert found[WARNING.text] == WARNING
    assert found[NOTE.text].kind is Kind.NOTE


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
    assert parsed(line).sentences == said


@pytest.mark.parametrize(
    ("text", "count"), [("a; b (c; d); e", 3), ("a;b", 1), ("", 0), ("one", 1), ("x [y; z]; do", 2)]
)
def test_clauses_of_a_text_make_the_text_again(text, count):
    found = Message(clauses_of(text))
    assert (found.text, len(found.clauses)) == (text, count)
