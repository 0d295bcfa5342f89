import io
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from backend.errors import BackendError
from backend.g2o import read_g2o, write_g2o
from backend.pose_graph.graph import PoseGraph, build_pose_graph
from backend.pose_graph.problem import from_pose_graph
from tests.backend.synthetic import flight, graph

V = "VERTEX_SE2 {} {} 0 0\n"
E = "EDGE_SE2 {} {} 1 0 0 10 0 0 10 0 10\n"
PLANAR = V.format(0, 0) + V.format(1, 1) + E.format(0, 1)
SPATIAL = (
    "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
    "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6\n"
)


def _written(path: Path, made: PoseGraph) -> Path:
    with path.open("w", encoding="ascii") as stream:
        write_g2o(stream, made)
    return path


def _read(tmp_path: Path, text: str) -> PoseGraph:
    path = tmp_path / "g.g2o"
    path.write_text(text)
    return read_g2o(path)


@pytest.mark.parametrize("dimension", [2, 3])
def test_gtsam_reads_what_we_write_and_has_the_same_error(tmp_path: Path, dimension: int):
    ours = graph(3, dimension)
    path = _written(tmp_path / "g.g2o", ours)
    theirs, values = gtsam.readG2o(str(path), dimension == 3)
    problem = from_pose_graph(ours)
    mine = problem.edge_factors().error(problem.values(ours.poses))
    assert mine > 1
    assert theirs.error(values) == pytest.approx(mine, rel=1e-9)
    np.testing.assert_allclose((problem.residuals(ours.poses) ** 2).sum() / 2, mine, rtol=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_we_read_what_gtsam_writes(tmp_path: Path, dimension: int):
    ours = from_pose_graph(graph(4, dimension))
    path = tmp_path / "g.g2o"
    gtsam.writeG2o(ours.edge_factors(), ours.values(ours.initial), str(path))
    read = from_pose_graph(read_g2o(path))
    mine = read.edge_factors().error(read.values(read.initial))
    # gtsam writes six digits.
    assert mine == pytest.approx(ours.edge_factors().error(ours.values(ours.initial)), rel=5e-2)


def test_planar_lines_of_toro_are_read_as_gtsam_reads_them(tmp_path: Path):
    """TORO has the elements of the information in an order of its own."""
    path = tmp_path / "g.graph"
    path.write_text(
        "VERTEX2 0 0 0 0\nVERTEX2 1 1.2 0.1 0.3\nEDGE2 0 1 1 0 0.2 50 1 60 700 2 3\n", encoding="ascii"
    )
    theirs, values = gtsam.load2D(str(path), noiseFormat=gtsam.NoiseFormat.NoiseFormatTORO)
    problem = from_pose_graph(read_g2o(path))
    mine = problem.edge_factors().error(problem.values(problem.initial))
    assert theirs.error(values) == pytest.approx(mine, rel=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_round_trip_is_exact(tmp_path: Path, dimension: int):
    ours = graph(5, dimension)
    ours = replace(ours, ids=ours.ids * 3 + 7, fixed=ours.ids == 2)
    back = read_g2o(_written(tmp_path / "g.g2o", ours))
    for name in ("ids", "i", "j", "fixed"):
        np.testing.assert_array_equal(getattr(back, name), getattr(ours, name))
    for name in ("poses", "ij_T", "information"):
        np.testing.assert_allclose(getattr(back, name), getattr(ours, name), rtol=1e-12, atol=1e-12)
    assert back.warnings == ()


def test_spatial_information_is_turned_rotation_first(tmp_path: Path):
    read = _read(tmp_path, SPATIAL)
    np.testing.assert_array_equal(np.diag(read.information[0]), [4, 5, 6, 1, 2, 3])


def test_keyframes_without_a_pose_are_left_out():
    made = flight(1, n=10, loops=2)
    truth = made.truth.copy()
    truth[4] = np.nan
    stream = io.StringIO()
    write_g2o(stream, build_pose_graph(truth, made.measurements.relative_poses))
    tags = [line.split()[:2] for line in stream.getvalue().splitlines()]
    assert ["VERTEX_SE3:QUAT", "4"] not in tags
    assert sum(tag == "VERTEX_SE3:QUAT" for tag, _ in tags) == 9


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PLANAR + "VERTEX_XY 5 1 2\nEDGE_SE2_XY 0 5 1 2 3 4 5\n# note\n\n", "2 lines of kinds"),
        (PLANAR + E.format(1, 1), "1 edge from a vertex to itself"),
        (PLANAR + 2 * PLANAR.splitlines(keepends=True)[-1], "2 edges repeat another one in all digits"),
        (E.format(0, 1) + E.format(1, 2), "no vertices in the file: the 3"),
        (PLANAR + "EDGE_SE2 0 1 1 0 0 10 0", "truncated"),
        (SPATIAL.replace("0 0 0 0 0 0 0 1\n", "0 0 0 0 0 0 0 2\n", 1), "1 quaternion not of length 1"),
    ],
)
def test_dropped_and_repaired_lines_are_counted(tmp_path: Path, text: str, expected: str):
    read = _read(tmp_path, text)
    assert len(read.warnings) == 1
    assert expected in read.warnings[0]
    assert len(read.i) == text.count("EDGE_SE2 ") - ("itself" in expected) - ("truncated" in expected) or (
        read.dimension == 3
    )


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "marked"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "dos", "old mac"])
def test_how_an_editor_marks_text_and_ends_lines_is_no_matter(tmp_path: Path, mark: str, end: str):
    path = tmp_path / "g.g2o"
    path.write_bytes((mark + PLANAR).replace("\n", end).encode())
    read = read_g2o(path)
    assert read.warnings == ()
    assert (len(read.ids), len(read.i)) == (2, 1)
    path.write_bytes((mark + PLANAR + "EDGE_SE2 0\n").replace("\n", end).encode())
    with pytest.raises(BackendError, match=":4: EDGE_SE2 has 1 fields"):
        read_g2o(path)


def test_non_unit_quaternion_becomes_a_rotation(tmp_path: Path):
    read = _read(tmp_path, SPATIAL.replace("QUAT 1 1 0 0 0 0 0 1", "QUAT 1 1 0 0 0 0 2 2"))
    np.testing.assert_allclose(read.poses[1, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("hello world\n", "no VERTEX_SE2"),
        ("\0\1\2", "binary"),
        (PLANAR + SPATIAL, "split it"),
        (V.format(0, 0), "no edge"),
        (V.format(0, 0) + E.format(0, 0), "no edge"),
        (V.format(0, 0) + E.format(0, 1), ":2: an edge names a vertex"),
        (PLANAR + V.format(1, 1), ":4: vertex 1 stands there and on line 2"),
        (PLANAR + "EDGE_SE2 0 1 1 0\n" + E.format(0, 1), ":4: EDGE_SE2 has 4 fields instead of 11"),
        (PLANAR.replace("1 0 0 10", "nan 0 0 10"), ":3: EDGE_SE2 has a field"),
        (PLANAR.replace("1 0 0 10", "inf 0 0 10"), ":3: EDGE_SE2 has a field"),
        (PLANAR.replace("1 0 0 10", "1e300 0 0 10"), ":3: EDGE_SE2 has a coordinate beyond"),
        (PLANAR.replace("SE2 1 1", "SE2 1 -1e300"), ":2: VERTEX_SE2 has a coordinate beyond"),
        (PLANAR.replace("1 0 0 10", "abc 0 0 10"), ":3: EDGE_SE2 has a field"),
        (PLANAR.replace("EDGE_SE2 0", "EDGE_SE2 x"), ":3: vertex 'x'"),
        (PLANAR.replace("EDGE_SE2 0", "EDGE_SE2 0_0"), ":3: a number of EDGE_SE2 holds '_'"),
        (PLANAR.replace("1 0 0 10", "1_0 0 0 10"), ":3: a number of EDGE_SE2 holds '_'"),
        (PLANAR + "FIX 0_1\n", ":4: a number of FIX holds '_'"),
        ("VERTEX3 0 0 0 0 0 0 0\n", "spatial lines of TORO"),
        (PLANAR.replace("EDGE_SE2 0", "EDGE_SE2 -1"), ":3: vertex '-1'"),
        (PLANAR.replace("10 0 10\n", "-10 0 10\n"), ":3: the information matrix is not positive"),
        (PLANAR.replace("10 0 0 10 0 10", "0 0 0 0 0 0"), ":3: the information matrix is not positive"),
        (PLANAR.replace("10 0 0 10 0 10", "10 0 0 10 0 1e100"), ":3: the information is beyond 1e"),
        (SPATIAL.replace("QUAT 0 1 1 0 0 0 0 0 1", "QUAT 0 1 1 0 0 0 0 0 0"), ":3: the quaternion is zero"),
        (
            SPATIAL.replace("QUAT 0 1 1 0 0 0 0 0 1", "QUAT 0 1 1 0 0 0 0 0 1e308"),
            ":3: the quaternion is of length",
        ),
        (PLANAR + "FIX 9\n", ":4: FIX names vertex 9"),
    ],
)
def test_invalid_files_raise_one_line_that_names_the_position(tmp_path: Path, text: str, expected: str):
    with pytest.raises(BackendError) as refused:
        _read(tmp_path, text)
    assert expected in str(refused.value)
    assert "g.g2o" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_landmark_that_is_fixed_is_left_out_with_a_warning(tmp_path: Path):
    graph = _read(tmp_path, PLANAR + "VERTEX_XY 9 1 2\nFIX 9 1\n")
    assert graph.fixed.tolist() == [False, True]
    assert any("FIX names vertex 9, which is of a kind" in line for line in graph.warnings)


def test_missing_file_and_folder_are_refused(tmp_path: Path):
    with pytest.raises(BackendError, match="cannot be read"):
        read_g2o(tmp_path / "none.g2o")
    with pytest.raises(BackendError, match="is not a file"):
        read_g2o(tmp_path)


def test_signs_of_a_damaged_file_are_warnings(tmp_path: Path):
    """A last line without a line break, and an information with two lost zeros or too many."""
    path = _written(tmp_path / "made.g2o", graph(1, 2, n=30))
    text = path.read_text()
    assert _read(tmp_path, text).warnings == ()
    assert "no line break" in _read(tmp_path, text.rstrip("\n")).warnings[-1]
    made = read_g2o(path)
    information = made.information.copy()
    information[4] *= 1e7
    odd = _written(path, replace(made, information=information))
    (warning,) = read_g2o(odd).warnings
    line = 1 + next(n for n, row in enumerate(odd.read_text().split("\n")) if row.startswith("EDGE"))
    assert f"line {line + 4}," in warning
    assert "1 edge " in warning
