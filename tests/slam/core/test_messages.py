"""Messages: their kinds, what they are about, and their sentences."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from slam.core.messages import (
    Kind,
    Message,
    about,
    as_message,
    as_note,
    as_reason,
    by_kind,
    joined,
)
from slam.core.summary import summarise
from slam.io.estimate import read_estimate, write_estimate
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from tests.slam.io.made_flight import made_flight
from tests.slam.made_estimate import made_estimate

WARNING = about("sonar0", "stuck: no echo; repair it")
NOTE = as_note("times from the camera's clock; the map does not depend on it")
REASON = as_reason("the map is in 2 parts; fly again")


def test_a_message_keeps_its_kind_and_what_it_is_about_when_its_text_changes():
    assert WARNING.of_flight("part") == Message("part: sonar0: stuck: no echo; repair it", about="sonar0")
    assert NOTE.extended("x").kind is Kind.NOTE
    assert pickle.loads(pickle.dumps(NOTE)) == NOTE


def test_a_message_has_its_finding_and_the_next_step():
    for message in (WARNING, WARNING.of_flight("part")):
        assert (message.finding, message.verdict) == ("stuck: no echo", "stuck")
        assert message.next_step == "repair it"
        assert message.begins_with_colon
    leans = Message("attitude0 leans (5°; 2 sigmas)", about="attitude0")
    assert (leans.finding, leans.next_step) == ("leans (5°; 2 sigmas)", "")
    assert not leans.begins_with_colon


def test_the_status_is_made_of_the_reasons():
    """A text that is a reason and a message of the flight too stands once, among the reasons."""
    messages = joined("other", NOTE, as_reason(WARNING), REASON, WARNING, "")
    assert messages == (as_reason(WARNING), REASON, as_message("other"), NOTE)
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
    assert Message(line).sentences == said
