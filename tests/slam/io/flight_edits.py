"""A written flight folder changed by hand, and what reading it then says."""

import re

import pytest

from slam.core.errors import InputError
from slam.io.flight_folder import read_flight

WHAT_NEXT = re.compile(
    r"; (add|check|convert|copy|correct|did you mean|docs/|record|the lines before)|power loss\?|"
    r"\d+ of \d+ (rows|values)"
)
"""What to do, what has happened, or how little of the stream it is."""


def mav(folder, name):
    return folder / "mav0" / name


def change(path, *edits):
    """Replace text in a file; the text must be there."""
    text = path.read_text()
    for old, new in edits:
        assert re.search(old, text, re.MULTILINE), old
        text = re.sub(old, new, text, count=1, flags=re.MULTILINE)
    path.write_text(text)


def change_row(path, line, column, value):
    lines = path.read_text().splitlines()
    fields = lines[line - 1].split(",")
    fields[column] = value
    lines[line - 1] = ",".join(fields)
    path.write_text("\n".join(lines) + "\n")


def scale(path, columns, factor):
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        for c in columns:
            row[c] = row[c] and repr(float(row[c]) * factor)
    path.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")


def assert_refused(folder, *words):
    with pytest.raises(InputError) as caught:
        read_flight(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert "; " in message  # what to do
    for word in words:
        assert word in message, message
    return message


def assert_warned(folder, *words):
    flight = read_flight(folder)
    untold = [line for line in flight.warnings if not WHAT_NEXT.search(line)]
    assert untold == []
    assert any(all(w in line for w in words) for line in flight.warnings), flight.warnings
    return flight
