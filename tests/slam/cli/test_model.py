"""``--model`` on the command line: from a verdict's file into the map, and its warning."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from slam.cli import app
from slam.cli.criticise import MAX_PICTURES_BY_DEFAULT, gains_in_maps
from slam.cli.options import GRAPH_PARAMETERS
from slam.cli.output_folder import writer_of
from slam.core.progress import silent
from slam.criticism.cause import Cause, Gain, Interval
from slam.criticism.extended import with_certainty
from slam.criticism.verdict.criticism import Criticism
from slam.io.flight_folder import read_flight, write_flight
from slam.simulation.model import load_model, save_model
from tests.slam.small_flight import flown, recipe

TERMS = {"sonar_scale": {"eps": 0.08}, "focal_length": {"eps": 0.03}, "sonar_spikes": {"share": 0.01}}


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "120"})


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A flight whose sonar reads long, and the model that knows it."""
    home = tmp_path_factory.mktemp("askew")
    write_flight(flown(1, terms=TERMS), home / "flight")
    save_model(replace(recipe(terms=TERMS).model, name="found"), home / "extended.toml")
    return home


@pytest.mark.slow
def test_the_map_is_corrected_by_the_model(home):
    model = home / "extended.toml"
    result = run("optimize", home / "flight", "--out", home / "out", "--no-mosaic", "--model", model)
    assert result.exit_code == 0, result.output
    assert "Gain of the model in the map" in result.output
    warning = next(w for w in json.loads((home / "out/summary.json").read_text())["warnings"] if "found" in w)
    assert "sonar_scale (eps 0.08)" in warning
    assert "left as it is: sonar_spikes" in warning
    assert "as recorded" in (home / "out/report.html").read_text()
    assert run("evaluate", home / "out", "--truth", home / "flight").exit_code == 0
    evaluation = json.loads((home / "out/evaluation.json").read_text())
    assert abs(evaluation["ate_sim3_m"]["scale"] - 1) < 0.01
    # Landmarks are seen by the camera that the model knows, which the output holds.
    assert abs(evaluation["landmarks"]["A-B"]["error_percent"]) < 1.0
    assert load_model(home / "out/model.toml") == load_model(model)
    assert writer_of(home / "out") == "optimize"


@pytest.mark.slow
def test_estimate_is_corrected_by_the_model(home):
    height_m = []
    for options in ((), ("--model", home / "extended.toml")):
        out = home / f"estimate{len(options)}"
        assert run("estimate", home / "flight", "--out", out, *options).exit_code == 0
        rows = [line.split() for line in (out / "trajectory.tum").read_text().splitlines() if line[0] != "#"]
        height_m.append(float(rows[len(rows) // 2][3]))
    assert height_m[0] / height_m[1] == pytest.approx(1.08, abs=0.03)


@pytest.mark.parametrize("command", ["optimize", "estimate"])
def test_a_missing_model_is_refused_before_any_work(command, home, tmp_path):
    result = run(command, home / "flight", "--out", tmp_path / "out", "--model", tmp_path / "none.toml")
    assert result.exit_code == 1
    assert "none.toml: does not exist" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("optimize", ["--model", "nominal"]),
        ("optimize", ["--gsd", "0.1"]),
        ("optimize", ["--config", "settings.toml", "--features", "sift"]),
        ("optimize", ["--topic", "imu0=/imu", "--picture-rate", "2"]),
        ("info", ["--topic", "imu0=/imu"]),
    ],
)
def test_options_of_flights_are_refused_with_a_graph(command, options, tmp_path):
    graph, out = tmp_path / "g.g2o", tmp_path / "out"
    graph.write_text("VERTEX_SE2 0 0 0 0\n")
    result = run(command, graph, *(["--out", out] if command == "optimize" else []), *options)
    assert result.exit_code == 1
    named = ", ".join(options[::2])
    leave = "leave them out" if len(options) > 2 else "leave it out"
    line = f"slam: {named}: {graph} is a graph, without pictures and instruments; {leave}\n"
    assert result.stderr == line
    assert not out.exists()


def test_only_parameters_that_a_graph_uses_are_accepted_with_one():
    """A new option of ``slam optimize`` is refused with a graph until it is named."""
    parameters = {p.name for p in get_command(app).commands["optimize"].params}
    assert {*GRAPH_PARAMETERS} - {"source"} <= parameters
    assert parameters - {*GRAPH_PARAMETERS} >= {"gsd", "config", "features", "model", "topic"}


@pytest.mark.slow
def test_the_gain_of_an_instrument_s_correction_is_measured_in_the_map(home):
    flight = read_flight(home / "flight")
    interval = Interval(0.08, "1", 0.07, 0.09)
    cause = Cause("sonar_scale", 1.0, {"eps": interval}, Gain(9.0, (1.0, 20.0), "flight", (), ()), 9.0, 9.0)
    extended = with_certainty(load_model(home / "extended.toml"), [cause])
    assert extended.std == {"sonar_scale": {"eps": pytest.approx(0.02 / 3.92)}}
    verdict = Criticism("named", "", (cause,), model=load_model("nominal"), extended=extended)
    (gain,) = gains_in_maps([flight, replace(flight, truth=None)], verdict, MAX_PICTURES_BY_DEFAULT, silent)
    assert abs(gain.after.scale - 1) < 0.01 < 0.04 < abs(gain.before.scale - 1)
    of_vehicle = replace(verdict, causes=(replace(cause, name="quadratic_drag"),))
    assert gains_in_maps([flight], of_vehicle, None, silent) == []
    assert gains_in_maps([flight], verdict, len(flight.frames) - 1, silent) == []
