"""The command line as the shell sees it: exit codes, one line on standard error, outputs whole or absent."""

from __future__ import annotations

import json
import os
import re
import sys

import numpy as np
import pytest

import slam.__main__
import slam.cli.graph
from slam.cli.output_folder import MARKER_NAME
from slam.io.estimate import read_estimate
from tests.slam.cli.commands import SQUARE, assert_refused, run, shell

GRAPH_FILES = {
    MARKER_NAME, "trajectory.tum", "graph.g2o", "estimate.npz", "loops.csv", "summary.json", "report.html",
    "map.html",
}  # fmt: skip


def test_info_and_optimize_report_rank_deficient_edges(graph, tmp_path, no_figures):
    graph.write_text(SQUARE.replace("1 2 1 0 1.5707963 100", "1 2 1 0 1.5707963 0"))
    for command in (("info", graph), ("optimize", graph, "--out", tmp_path / "out")):
        printed = " ".join(run(*command).stdout.split())
        assert "1 of 4 edges tells nothing about some direction" in printed


def test_version_and_help():
    assert run("--version").stdout == f"slam {slam.__version__}\n"
    for command in ("", "demo", "optimize", "evaluate", "simulate", "import", "info"):
        result = run(*command.split(), "--help")
        assert result.exit_code == 0
        assert "Usage" in result.stdout
    listed = run("--help").stdout
    assert all(
        command in listed for command in ("demo", "optimize", "evaluate", "simulate", "import", "info")
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ("optimise",),
        ("optimize",),
        ("optimize", "flight"),
        ("optimize", "flight", "--out", "o", "--features", "brisk"),
        ("optimize", "flight", "--out", "o", "--gsd", "0"),
        ("optimize", "flight", "--out", "o", "--gsd", "-1"),
        ("optimize", "flight", "--out", "o", "--gsd", "1e-5"),
        ("optimize", "flight", "--out", "o", "--gsd", "101"),
        ("optimize", "flight", "--out", "o", "--gsd", "inf"),
        ("optimize", "flight", "--out", "o", "--gsd", "nan"),
        ("estimate", "flight", "--out", "o", "--rate", "nan"),
        ("simulate", "figure_eight", "--out", "o", "--seed", "one"),
        ("demo", "--seed", "-1"),
        ("--nonsense",),
    ],
)
def test_wrong_usage_is_exit_code_2(arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_an_interrupt_while_the_commands_are_loaded_is_one_line(monkeypatch, capsys):
    class Loading:
        def __getattr__(self, name):
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "slam.cli", Loading())
    with pytest.raises(SystemExit) as left:
        slam.__main__.main()
    assert left.value.code == 130
    assert capsys.readouterr().err == "slam: interrupted; nothing was written\n"


def test_a_terminal_without_unicode_is_supported(graph, tmp_path):
    """In the C locale a table's sigma cannot be printed; the work is done all the same."""
    plain = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    out = tmp_path / "M\u00fcnchen"
    done = shell("optimize", graph, "--out", out, env=plain)
    assert (done.returncode, "Error" in done.stderr) == (0, False)
    assert "?" in done.stdout
    assert (out / "report.html").exists()


# ---- graphs: the back end alone


def test_a_graph_is_solved_and_every_file_is_there(graph, tmp_path):
    result = run("optimize", graph, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert set(os.listdir(tmp_path / "out")) == GRAPH_FILES
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["status"] == "ok"
    assert summary["error"] < 1e-9, "a square closes"
    assert summary["certificate"]["certified"] is True
    assert summary["edges"] == {"odometry": 3, "loop": 1, "rejected": {}}
    assert summary["iterations"] >= 1
    assert any("held" in warning for warning in summary["warnings"]), "no gauge: held, with a warning"
    trajectory = np.loadtxt(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_array_equal(trajectory[:, 0], [0, 1, 2, 3])
    np.testing.assert_allclose(trajectory[:, 1:3], [[0, 0], [1, 0], [1, 1], [0, 1]], atol=1e-6)
    assert "loop closure holds it together" in (tmp_path / "out" / "report.html").read_text()
    estimate = read_estimate(tmp_path / "out")
    np.testing.assert_allclose(estimate.w_T_b[2, :2, 3], [1, 1], atol=1e-6)


@pytest.mark.parametrize(
    "first",
    [9_300_000_000, 2**63 - 4, *(pytest.param(ord(c) << 56, marks=pytest.mark.slow) for c in "ax")],
)
def test_vertex_numbers_may_have_63_bits(graph, tmp_path, first, no_figures):
    """Stamps in nanoseconds cannot hold such numbers, so that stamps count the vertices."""
    lines = [line.split() for line in SQUARE.splitlines()]
    for fields in lines:
        for k in range(1, 3 if fields[0].startswith("EDGE") else 2):
            fields[k] = str(first + int(fields[k]))
    graph.write_text("\n".join(" ".join(fields) for fields in lines))
    result = run("optimize", graph, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["status"], summary["error"] < 1e-9) == ("ok", True)
    assert any("too large for stamps" in warning for warning in summary["warnings"])
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "out" / "trajectory.tum")[:, 0], [0, 1, 2, 3])
    estimate = read_estimate(tmp_path / "out")
    assert estimate.frame_names == tuple(str(first + k) for k in range(4))
    assert f"VERTEX_SE2 {first + 3} " in (tmp_path / "out" / "graph.g2o").read_text()


def test_the_written_graph_is_at_its_minimum(graph, tmp_path, no_figures):
    """Solving what was written changes nothing: vertices are the solution, edges are those given."""
    assert run("optimize", graph, "--out", tmp_path / "a").exit_code == 0
    assert run("optimize", tmp_path / "a" / "graph.g2o", "--out", tmp_path / "b").exit_code == 0
    a, b = (np.loadtxt(tmp_path / name / "trajectory.tum") for name in "ab")
    np.testing.assert_allclose(a, b, atol=1e-7)
    assert (tmp_path / "b" / "graph.g2o").read_text().count("EDGE_SE2") == 4


def test_lines_of_a_graph_that_are_not_used_are_counted(graph, tmp_path, no_figures):
    with graph.open("a") as stream:
        stream.write("EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1\nLANDMARK 3\nLANDMARK 4\n")
    printed = " ".join(run("optimize", graph, "--out", tmp_path / "o").stdout.split())
    assert "left out 2 x line of another kind, 1 x edge from a vertex to itself" in printed
    rejected = json.loads((tmp_path / "o" / "summary.json").read_text())["edges"]["rejected"]
    assert rejected == {"line of another kind": 2, "edge from a vertex to itself": 1}


def test_a_graph_without_vertices_starts_from_the_edges(graph, tmp_path, no_figures):
    edges = [line for line in SQUARE.splitlines() if line.startswith("EDGE")]
    graph.write_text("\n".join(edges) + "\n")
    assert run("optimize", graph, "--out", tmp_path / "out").exit_code == 0
    trajectory = np.loadtxt(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_allclose(trajectory[:, 1:3], [[0, 0], [1, 0], [1, 1], [0, 1]], atol=1e-6)


def test_two_components_are_reported(graph, tmp_path, no_figures):
    other = re.sub(r"(VERTEX_SE2|EDGE_SE2) (\d)( \d(?= ))?", _shifted, SQUARE)
    graph.write_text(SQUARE + other)
    assert run("optimize", graph, "--out", tmp_path / "out").exit_code == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "2 parts" in summary["status"]
    assert "2 separate maps" in (tmp_path / "out" / "report.html").read_text()


def _shifted(found: re.Match) -> str:
    if found[1] == "VERTEX_SE2":
        return f"VERTEX_SE2 1{found[2]}{found[3] or ''}"
    return f"EDGE_SE2 1{found[2]} 1{found[3].strip()}"


@pytest.mark.parametrize(
    ("content", "saying"),
    [
        ("", "empty"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 7 1 0 0 1 0 0 1 0 1\n", ":2: .*7"),
        ("EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n", "finite"),
        ("EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n", "information"),
        ("hello\n", ""),
        ("\0\0\0\0", ""),
    ],
)
def test_a_bad_graph_is_refused_and_nothing_is_written(graph, tmp_path, content, saying):
    graph.write_text(content)
    assert_refused(run("optimize", graph, "--out", tmp_path / "new" / "out"), saying)
    assert os.listdir(tmp_path) == ["square.g2o"]


# ---- inputs that are not what they should be


@pytest.mark.parametrize("command", ["optimize", "import"])
def test_a_path_without_a_flight_is_refused(command, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "thesis.tex").write_text("mine")
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "no\nlines").mkdir()
    os.mkfifo(tmp_path / "pipe")
    before = sorted(os.listdir(tmp_path))
    for name, saying in (
        ("missing", "does not exist"),
        ("empty", "is empty"),
        ("others", "no mav0 folder"),
        ("log.bag", "a ROS bag that its reader cannot read"),
        ("no\nlines", "is empty"),
        ("pipe", "neither a file nor a folder"),
    ):
        assert_refused(run(command, tmp_path / name, "--out", tmp_path / "out"), saying)
    assert sorted(os.listdir(tmp_path)) == before


def test_info_of_a_graph_counts(graph):
    result = run("info", graph)
    assert result.exit_code == 0
    assert re.search(r"vertices\s+4\b", result.stdout)
    assert re.search(r"other edges\s+1\b", result.stdout)


def test_evaluate_needs_an_output_of_slam(tmp_path):
    assert_refused(run("evaluate", tmp_path, "--truth", tmp_path), "slam optimize")
    assert os.listdir(tmp_path) == []


# ---- outputs


def test_a_low_memory_limit_is_refused(graph, tmp_path, monkeypatch):
    monkeypatch.setattr("resource.getrlimit", lambda _: (300 << 20, -1))
    assert_refused(run("optimize", graph, "--out", tmp_path / "out"), "ulimit")
    assert not (tmp_path / "out").exists()
