"""Information unlike that of the other edges is told, in one direction too; what varies smoothly is not."""

from __future__ import annotations

import numpy as np
import pytest

from backend.pose_graph.checks.unlike_information import unlike_information


def drawn(
    n: int, diagonal: tuple[float, ...], decades: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Lines and information of edges, spread by ``decades`` (a standard deviation)."""
    rng = np.random.default_rng(seed)
    information = np.zeros((n, len(diagonal), len(diagonal)))
    axes = np.arange(len(diagonal))
    information[:, axes, axes] = diagonal * 10 ** rng.normal(0.0, decades, (n, len(diagonal)))
    return np.arange(n) + 5, information


PLANAR, SPATIAL = (1000.0, 100.0, 100.0), (1000.0, 1000.0, 1000.0, 100.0, 100.0, 1.0)


@pytest.mark.parametrize("diagonal", [PLANAR, SPATIAL])
@pytest.mark.parametrize("decades", [0.0, 0.3, 1.0])
def test_smooth_spreads_are_not_told(diagonal: tuple[float, ...], decades: float):
    for seed in range(10):
        assert unlike_information(*drawn(200, diagonal, decades, seed)) == []


@pytest.mark.parametrize(
    ("diagonal", "axes"), [(PLANAR, [1, 2]), (PLANAR, [0]), (SPATIAL, [3, 4]), (SPATIAL, [5]), (SPATIAL, [0])]
)
@pytest.mark.parametrize("factor", [1e-5, 1e6, 0.0])
def test_one_edge_with_other_information_in_some_directions_is_told(
    diagonal: tuple[float, ...], axes: list[int], factor: float
):
    lines, information = drawn(200, diagonal, 0.1)
    information[77, axes, axes] *= factor
    (line,) = unlike_information(lines, information)
    assert "1 edge " in line
    assert "in line 82," in line


def test_a_second_kind_of_edge_is_not_told():
    """A fifth of the edges are loops that measure no turn."""
    lines, information = drawn(200, PLANAR, 0.1)
    information[:40, 0, 0] *= 1e-6
    assert unlike_information(lines, information) == []


def test_all_of_no_information_in_a_direction_are_alike():
    assert unlike_information(*drawn(50, (0.0, 1.0, 1.0), 0.1)) == []
    assert unlike_information(*drawn(0, PLANAR, 0.1)) == []
