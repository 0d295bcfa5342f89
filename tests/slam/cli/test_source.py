"""The kind of a path follows from its content."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.cli.output_folder import (
    CRITICISE_NAMES,
    ESTIMATE_NAMES,
    EVALUATE_NAMES,
    LOCATE_NAMES,
    LOOPS_NAMES,
    OPTIMIZE_NAMES,
    REPLAY_NAMES,
    REPRODUCE_NAMES,
)
from slam.cli.source import import_source, kind_of, open_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from slam.io.flight_folder import write_flight
from tests.slam.io.made_flight import made_flight

EUROC = ("mav0/cam0", "mav0/imu0", "mav0/state_groundtruth_estimate0")


def made(root, *entries):
    """Folders, and empty files where a name has a suffix."""
    root.mkdir()
    for entry in entries:
        path = root / entry
        (path.parent if path.suffix else path).mkdir(parents=True, exist_ok=True)
        if path.suffix:
            path.touch()
    return root


@pytest.mark.parametrize(
    ("entries", "kind"),
    [
        (("a.JPG",), "photos"),
        (("dcim/100/b.tiff", "notes.txt"), "photos"),
        (("a/b/c/d/e.jpg",), "photos"),
        ((".thumbs/a/.b.jpg",), "flight"),
        ((), "flight"),
        (EUROC, "euroc"),
        ((*EUROC, "mav0/cam1"), "euroc"),
        (("mav0/cam0", "mav0/sonar0", "mav0/body.yaml"), "euroc"),
        ((*EUROC, "flight.yaml"), "flight"),
        ((*EUROC, "mav0/cam1", "flight.yaml"), "flight"),
        (("mav0/cam0", "mav0/sonar0"), "flight"),
        (("mav0",), "flight"),
        (("one/mav0/cam0/data/1.png",), "flight"),
        (("day/one/mav0/cam0/data/1.png",), "flight"),
    ],
)
def test_the_kind_of_a_folder_follows_from_its_content(tmp_path, entries, kind):
    assert kind_of(made(tmp_path / "in", *entries)) == kind


def test_a_link_to_the_folder_above_hides_no_photographs(tmp_path):
    made(tmp_path / "other", "mav0")
    (made(tmp_path / "in", "a.jpg") / "up").symlink_to(tmp_path)
    assert kind_of(tmp_path / "in") == "photos"


def test_the_kind_of_an_inner_folder_is_that_of_the_outer(tmp_path):
    assert kind_of(made(tmp_path / "a", *EUROC) / "mav0") == "euroc"
    assert kind_of(made(tmp_path / "b", *EUROC, "flight.yaml") / "mav0") == "flight"


def test_a_graph_is_recognised_by_its_first_line(tmp_path):
    path = tmp_path / "graph.txt"
    path.write_text("\n EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert kind_of(path) == "graph"


def test_a_flight_without_flight_yaml_is_read(tmp_path):
    """Camera, IMU and truth alone look like EuRoC's; where z is up, nothing is renamed."""
    nothing = dict.fromkeys(
        ("sonar", "attitude", "velocity", "command", "battery", "gps", "barometer", "motor")
    )
    flight = replace(made_flight(), **nothing, landmarks={}, landmark_pairs=(), gaps=())
    write_flight(flight, tmp_path / "in")
    (tmp_path / "in" / "flight.yaml").unlink()
    read, kind = open_flight(tmp_path / "in", silent)
    assert kind == "euroc"
    assert abs(read.camera.b_T_c - flight.camera.b_T_c).max() < 1e-12
    assert not [line for line in read.warnings if "renamed" in line]


def test_a_folder_of_flights_names_them(tmp_path):
    root = made(tmp_path / "in", "one/mav0/cam0/data/1.png", "two/mav0/cam0/data/1.png")
    with pytest.raises(InputError, match="holds flights: one, two"):
        open_flight(root, silent)


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("optimize", OPTIMIZE_NAMES),
        ("estimate", ESTIMATE_NAMES),
        ("locate", LOCATE_NAMES),
        ("loops", LOOPS_NAMES),
        ("replay", REPLAY_NAMES),
        ("reproduce", REPRODUCE_NAMES),
        ("criticise", CRITICISE_NAMES),
    ],
)
def test_an_output_is_no_folder_of_photographs(tmp_path, command, names):
    root = made(tmp_path / "out", *names)
    for ask in (kind_of, lambda path: open_flight(path, silent), lambda path: import_source(path, silent)):
        with pytest.raises(InputError, match=f"is the output of slam {command}, no flight; give"):
            ask(root)


def test_the_refusal_of_an_output_names_its_graph(tmp_path):
    root = made(tmp_path / "out", *OPTIMIZE_NAMES, *EVALUATE_NAMES)
    with pytest.raises(InputError, match=f"its graph can be given, {root}/graph.g2o"):
        kind_of(root)
    assert kind_of(root / "graph.g2o") == "graph"


def test_photographs_beside_a_summary_are_photographs(tmp_path):
    assert kind_of(made(tmp_path / "in", "a.jpg", "summary.json")) == "photos"
