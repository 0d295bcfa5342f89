"""``slam criticise`` on one flight: held out by segments; its model simulates and replays."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.flight_folder import write_flight
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.cli.pulse_recipe import RECIPE

PLAN = ["steps of 0.25 to 0.10 and 0.25 to -0.15"]
DRAG = 0.3


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "120"})


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    """A flight with drag beyond linear."""
    folder = tmp_path_factory.mktemp("dragged") / "flight"
    nominal = at_lower_rates(load_model("nominal"))
    dragged = nominal.with_term("quadratic_drag", c=DRAG)
    write_flight(simulate_flight(dragged, stick_for(PLAN), 7, maker=nominal), folder)
    return folder


@pytest.fixture(scope="module")
def criticism(flight, tmp_path_factory) -> Path:
    """The criticism of the flight."""
    out = tmp_path_factory.mktemp("criticised") / "criticism"
    done = run("criticise", flight, "--out", out)
    assert done.exit_code == 0, done.output
    return out


@pytest.fixture(scope="module")
def verdict(criticism) -> dict:
    return json.loads((criticism / "verdict.json").read_text())


@pytest.mark.slow
def test_one_flight_is_held_out_by_segments(criticism, verdict):
    assert [cause["name"] for cause in verdict["causes"]] == ["quadratic_drag"], verdict["sentence"]
    gain = verdict["causes"][0]["gain"]
    assert gain["held_out_by"] == "segment"
    assert gain["nats"] > 0
    assert "On held-out segments" in verdict["sentence"]
    assert "held-out flights" not in " ".join([verdict["sentence"], *verdict["details"]])
    assert verdict["details"][-1].startswith("Next flight: ")
    assert "Each part in turn is held out" in (criticism / "report.html").read_text()


@pytest.mark.slow
def test_the_model_that_criticism_writes_simulates_and_replays(flight, criticism, verdict, tmp_path):
    model = criticism / "extended.toml"
    size = verdict["causes"][0]["parameters"]["c"]["value"]
    assert size == pytest.approx(DRAG, rel=0.3)
    (tmp_path / "pulse.csv").write_text("0,0,0,0,0\n500,0.4,0,0,0\n3000,0,0,0,0\n4000,0,0,0,0\n")
    (tmp_path / "pulse.toml").write_text(RECIPE)
    made = run("simulate", tmp_path / "pulse.toml", "--out", tmp_path / "made", "--model", model)
    assert made.exit_code == 0, made.output

    def off(flown: Path, with_model: object) -> float:
        out = tmp_path / f"{flown.name}-{Path(str(with_model)).stem}"
        done = run("replay", flown, "--model", with_model, "--out", out)
        assert done.exit_code == 0, done.output
        return json.loads((out / "summary.json").read_text())["channels"]["velocity.v_x"]["rms"]["2"]

    assert off(tmp_path / "made", model) < 0.8 * off(tmp_path / "made", "nominal")
    assert off(flight, model) < 0.1


@pytest.mark.parametrize(
    ("text", "saying"),
    [
        ("[terms.quadratic_drog]\nc = 0.1\n", "did you mean 'terms.quadratic_drag'"),
        ("[terms.quadratic_drag]\nk = 0.1\n", "terms.quadratic_drag.k"),
    ],
)
def test_an_unknown_term_is_refused_in_one_line(text, saying, flight, tmp_path):
    (tmp_path / "mine.toml").write_text(text)
    done = run("criticise", flight, "--model", tmp_path / "mine.toml", "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert re.fullmatch(rf"slam: [^\n]*mine.toml[^\n]*{re.escape(saying)}[^\n]*\n", done.stderr), done.stderr
    assert not (tmp_path / "out").exists()
