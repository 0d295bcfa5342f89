"""The table of located pictures."""

import csv
import io
import os
from pathlib import Path

from slam.cli.locate import locations_csv
from slam.mapping.relocation import nowhere


def test_a_picture_whose_name_is_not_utf_8_has_a_row():
    pictures = [Path(os.fsdecode(b"in/caf\xe9.jpg")), Path('in/"a", b.jpg')]
    text = locations_csv([(path, nowhere("unreadable: missing")) for path in pictures])
    text.encode("utf-8")
    rows = list(csv.reader(io.StringIO(text)))
    assert [row[:2] for row in rows[1:]] == [
        ["in/caf\\xe9.jpg", "unreadable: missing"],
        ['in/"a", b.jpg', "unreadable: missing"],
    ]
