"""How figures are judged and shown; the benchmarks themselves are opt-in (``make bench``)."""

import math

import pytest

from tests.benchmarks import blind_dev
from tests.benchmarks.figures import BEGIN, END, Section, markdown, measured, verdict, with_block
from tests.benchmarks.metric import at_least, at_most, reported, within


@pytest.mark.parametrize(
    ("metric", "met"),
    [
        (at_most("", 1.0, "x", 1.0), True),
        (at_most("", 1.01, "x", 1.0), False),
        (at_least("", 74, "", 74), True),
        (at_least("", 73, "", 74), False),
        (within("", 5.0, "", (4.0, 6.0)), True),
        (within("", 3.9, "", (4.0, 6.0)), False),
        (within("", 6.1, "", (4.0, 6.0)), False),
        (at_most("", math.nan, "x", 1.0), False),
        (at_least("", math.inf, "x", 1.0), False),
        (reported("", 1.0, "x"), None),
    ],
)
def test_a_limit_is_kept_or_not(metric, met):
    assert metric.met is met


def test_measured_and_asked_for_stand_in_one_unit():
    m = at_most("gap", 0.0012, "m", 0.010)
    assert (measured(m), verdict(m)) == ("1.20 mm", ("at most 10 mm", "met"))
    m = at_most("gap", 0.186, "m", 0.010)
    assert (measured(m), verdict(m)) == ("0.186 m", ("at most 0.0100 m", "missed"))


def test_only_the_block_changes():
    text = f"before\n\n{BEGIN}\nold\n{END}\n\nafter\n"
    once = with_block(text, "new")
    assert once == f"before\n\n{BEGIN}\nnew\n{END}\n\nafter\n"
    assert with_block(once, "new") == once


def test_a_readme_without_markers_gets_them_at_its_end():
    made = with_block("# Title\n", "new")
    assert made.startswith("# Title\n")
    assert with_block(made, "newer") == made.replace("new", "newer")


def test_an_open_block_is_refused():
    with pytest.raises(ValueError, match="never closed"):
        with_block(f"{BEGIN}\nold\n", "new")


def test_a_miss_and_a_skip_are_told():
    block = markdown(
        [
            Section("Part", [at_most("speed", 2.0, "x", 1.0, "how")], commit="abc"),
            Section("Other", [], "no data"),
        ]
    )
    assert "| speed <br><sub>how</sub> | 2 x | at most 1 x | **missed** |" in block
    assert "| **Part** | at abc | | |" in block
    assert "| **Other** | skipped: no data | | |" in block


def test_blind_cases_are_held_to_what_is_asked_of_them():
    def scored(nulls: int, singles: int, pairs: int, misnamed: int) -> dict:
        gate = {"nulls": 5, "nulls_right": nulls, "singles": 9, "singles_right": singles, "unknowns": 1}
        card = {"pairs: both found": {"hits": pairs, "of": 1}, "parameter error, median": {"rate": 0.3}}
        return {"gate": {**gate, "unknowns_misnamed": misnamed}, "card": card, "missing": []}

    good = blind_dev.figures(scored(5, 8, 1, 0), [121.0, 20.0, 30.0])
    assert [m.met for m in good] == [True, True, False, True, True, None, False, None]
    assert [measured(m) for m in good][:2] == ["5 of 5", "8 of 9"]
    assert (good[-1].value, good[-1].source[:11]) == (30.0, "case 2 of 3")
    bad = blind_dev.figures(scored(4, 7, 0, 1), [119.0, 20.0])
    assert [m.met for m in bad] == [False, False, False, False, False, None, True, None]
