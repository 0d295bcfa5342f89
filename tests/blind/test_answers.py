"""Runs that were stopped go on, of the same suite only; the page tells what they left."""

from __future__ import annotations

import sys

import pytest

from tests.blind import run
from tests.blind.answers import earlier, read, write
from tests.blind.page import WITHOUT, block, came_out, markdown
from tests.blind.score import Answer
from tests.blind.test_score import RIGHT, WRONG, case, says


def test_answers_are_read_as_they_were_written(tmp_path):
    file = tmp_path / "made" / "blind.json"
    asked = {"seed": 3, "kinds": ["null", "single"]}
    assert earlier(file, asked) == []
    write(file, asked, RIGHT)
    assert read(file) == (asked, RIGHT)
    assert earlier(file, asked) == RIGHT
    with pytest.raises(ValueError, match=r"another suite \(seed\): remove it"):
        earlier(file, {**asked, "seed": 4})
    assert list(tmp_path.rglob("*.part")) == []


def test_a_run_goes_on_where_one_was_stopped(tmp_path, monkeypatch, capsys):
    judged = []

    def judge(options, drawn):
        index, (kind, _) = drawn
        judged.append(index)
        made = case(kind)
        return Answer(type(made)(f"case_{index:03d}", kind, (), 40.0), says("nothing_wrong"), 1.0, "abc")

    monkeypatch.setattr(run, "judged", judge)

    def asked(*more: str) -> None:
        where = ["--out", str(tmp_path / "blind.json"), "--kinds", "null", "--jobs", "1"]
        monkeypatch.setattr(sys, "argv", ["run", *where, *more])
        run.main()

    asked("--cases", "3")
    asked("--cases", "2", "--first", "5")
    asked("--cases", "7")
    assert judged == [0, 1, 2, 5, 6, 3, 4]
    assert len(read(tmp_path / "blind.json")[1]) == 7
    assert "0 of 7" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        asked("--seed", "9")
    assert "another suite (seed)" in capsys.readouterr().err


@pytest.mark.slow
def test_the_page_tells_the_card_and_what_came_out_wrong():
    assert all(came_out(answer) for answer in RIGHT)
    assert not any(came_out(answer) for answer in WRONG)
    good, bad = markdown(RIGHT, ["make blind"]), markdown([*RIGHT, *WRONG])
    assert "`make blind`" in good
    assert good.count("**missed**") == 3
    assert "| detected, d >= 6 | 1 of 1 | 100.0 % | 20.7 to 100.0 % | at least 90 % | met |" in good
    assert "wrong verdict: 0" in good
    assert f"wrong verdict: {len(WRONG)}" in bad
    assert (
        "| false alarms, clean | 1 of 2 | 50.0 % | 9.5 to 90.5 % | at most 2 % | **missed** |"
        " interval within 0.5 to 1.5 % | **missed** |" in bad
    )


@pytest.mark.slow
def test_cases_without_command_logs_have_a_card_of_their_own():
    asked = {"seed": 3, "flights": 4, "kinds": ["null"]}
    known, blind = block([(asked, RIGHT), (asked | {"without_commands": True}, WRONG)]).split(WITHOUT)
    assert "wrong verdict: 0" in known
    assert "--without-commands" not in known
    assert f"### Cases with a wrong verdict: {len(WRONG)}" in blind
    assert "--kinds null --without-commands`" in blind
    assert WITHOUT not in block([(asked, RIGHT)])
