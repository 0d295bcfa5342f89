"""The status of a graph whose attitudes are too uncertain for any certificate."""

from __future__ import annotations

from pathlib import Path

from backend.g2o import write_g2o
from slam.cli.graph import solve_graph
from tests.backend.pose_graph.test_lower_minimum import uncertain


def test_another_arrangement_is_a_doubt_where_nothing_certifies_the_minimum(tmp_path: Path):
    path = tmp_path / "g.g2o"
    with path.open("w", encoding="ascii") as stream:
        write_g2o(stream, uncertain(2))
    estimate, _ = solve_graph(path, lambda *_: None)
    assert estimate.certificate is not None
    assert not estimate.certificate.certified
    assert "no other arrangement of the poses fits better" in estimate.status
