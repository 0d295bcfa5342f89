"""Progress: counted by the library, shown by the command line."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from rich.console import Console
from typer.testing import CliRunner

from slam.cli import app
from slam.cli.console import show_progress
from slam.core.flight import Flight
from slam.core.progress import Tally
from slam.core.streams import Imu
from slam.io.flight_writer import write_flight


def test_parts_of_several_threads_are_counted_when_they_end():
    steps = []
    tally = Tally(lambda *step: steps.append(step), "screen", 40)

    def one(_):
        with tally.part():
            pass

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(one, range(40)))
    done = [step[1] for step in steps]
    assert done == sorted(done)
    assert (steps[0], steps[-1]) == (("screen", 0, 40), ("screen", 40, 40))


def test_an_item_is_finished_when_the_next_is_requested():
    steps = []
    parts = Tally(lambda *step: steps.append(step), "try").each("ab")
    assert [next(parts), steps[-1]] == ["a", ("try", 0, 0)]
    assert [next(parts), steps[-1]] == ["b", ("try", 1, 0)]
    assert next(parts, None) is None
    assert steps[-1] == ("try", 2, 0)


def test_a_log_has_one_line_for_each_stage():
    out = io.StringIO()
    with show_progress(Console(file=out)) as progress:
        list(Tally(progress, "screen").each(range(3)))
        list(Tally(progress, "pictures", 3).each(range(3)))
    assert out.getvalue().splitlines() == ["screen", "pictures (3)"]


def test_criticism_shows_its_progress(tmp_path):
    stamps_s = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 0.01, (2, len(stamps_s), 3))
    imu = Imu(stamps_s, noise[0], noise[1] + [0.0, 0.0, 9.81], 1e-3, 1e-2)
    write_flight(Flight("still", imu=imu), tmp_path / "still")
    result = CliRunner().invoke(app, ["criticise", str(tmp_path / "still"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines()[:2] == ["instruments (1)", "report (1)"]
