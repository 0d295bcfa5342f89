"""The folders of blind cases: what they hold, and that nothing but numbers tells a faulty one."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from tests.blind import folder
from tests.blind.cases import make
from tests.blind.instruments import RATE_HZ


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("made")
    make("null_heavy", 7, 4, home, flights=2, duration_s=8.0)
    return home / "case_004"


def rows_of(file: Path) -> tuple[list[str], list[list[str]]]:
    head, *rows = csv.reader(file.read_text(encoding="utf-8").splitlines())
    return head, rows


def test_a_folder_holds_what_the_format_says(made):
    assert sorted(p.name for p in made.iterdir()) == ["flight_00", "flight_01"]
    for flight in made.iterdir():
        assert sorted(p.name for p in (flight / "mav0").iterdir()) == sorted([*RATE_HZ, "command0"])
        for stream in (flight / "mav0").iterdir():
            head, rows = rows_of(stream / "data.csv")
            assert head[0] == "#timestamp [ns]"
            assert ",".join(head[1:]) == folder.HEADER[stream.name]
            stamps = np.array([int(row[0]) for row in rows])
            assert np.all(np.diff(stamps) > 0)
            assert {len(row) for row in rows} == {len(head)}
            seconds = (stamps[-1] - stamps[0]) / 1e9
            assert 7.5 < seconds < 8.1
            assert len(rows) / seconds > 0.99 * RATE_HZ.get(stream.name, 20.0)


def test_a_case_is_what_its_seed_says(made, tmp_path):
    make("null_heavy", 7, 4, tmp_path, flights=2, duration_s=8.0)
    other = make("null_heavy", 8, 4, tmp_path / "other", flights=2, duration_s=8.0)
    files = sorted(f.relative_to(made) for f in made.rglob("data.csv"))
    assert all((tmp_path / "case_004" / f).read_bytes() == (made / f).read_bytes() for f in files)
    theirs = tmp_path / "other" / other.name
    assert all((theirs / f).read_bytes() != (made / f).read_bytes() for f in files)


def test_nothing_but_numbers_tells_a_faulty_case(made, tmp_path):
    """Names, yaml files and columns are the same whatever is hidden."""
    make("single", 7, 4, tmp_path, flights=2, duration_s=8.0, fault="sonar_bias", d=6.0)
    theirs = tmp_path / "case_004"
    kept = [sorted(str(f.relative_to(home)) for f in home.rglob("*")) for home in (made, theirs)]
    assert kept[0] == kept[1]
    for file in made.rglob("*.yaml"):
        assert file.read_bytes() == (theirs / file.relative_to(made)).read_bytes()


def test_a_shifted_flight_differs_by_the_shift_alone(made, tmp_path):
    folder.shifted(made / "flight_00", tmp_path / "f", seconds=1000.0, turn=2.0)
    for stream in (made / "flight_00" / "mav0").iterdir():
        before, after = (rows_of(h / "data.csv")[1] for h in (stream, tmp_path / "f" / "mav0" / stream.name))
        moved = [int(b[0]) - int(a[0]) for a, b in zip(before, after, strict=True)]
        assert set(moved) == {10**12}
        if stream.name != "attitude0":
            assert [r[1:] for r in before] == [r[1:] for r in after]
            continue
        yaw = np.array([[float(r[3]) for r in rows] for rows in (before, after)])
        np.testing.assert_allclose(np.mod(yaw[1] - yaw[0] - 2.0 + np.pi, 2 * np.pi), np.pi, atol=2e-5)
        assert np.abs(yaw).max() <= np.pi + 1e-5
