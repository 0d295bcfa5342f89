"""Experiments by name: what is known, what is refused, in which order they run."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.core.errors import InputError
from slam.experiments.experiment import Experiment
from slam.experiments.registry import NAMES, chosen, experiment

ROOT = Path(__file__).parents[3]


def test_all_without_a_name():
    assert chosen(()) == NAMES


def test_the_order_is_the_papers_whatever_was_asked_first():
    assert chosen(("hover", "table1", "hover")) == ("table1", "hover")


def test_table_4_stands_beside_table_3():
    assert chosen(("table4",)) == chosen(("table3",)) == ("table3",)


def test_a_name_that_is_not_known_names_the_nearest_in_one_line():
    with pytest.raises(InputError, match="did you mean 'table5'") as refused:
        chosen(("table1", "tabel5"))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", NAMES)
def test_each_module_holds_the_experiment_of_its_name(name):
    made = experiment(name)
    assert isinstance(made, Experiment)
    assert made.name == name
    assert made.title
    assert "section" in made.source or "table" in made.source


def test_the_page_and_the_help_name_them_all():
    page = (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")
    assert tuple(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == NAMES
    helped = " ".join(CliRunner().invoke(app, ["reproduce", "--help"], terminal_width=400).output.split())
    for name in NAMES:
        assert name in helped, name
