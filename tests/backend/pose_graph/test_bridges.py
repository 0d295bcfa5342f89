"""Bridges against networkx, on random graphs with trees, cycles and parts that single edges join."""

import networkx
import numpy as np
import pytest

from backend.pose_graph.bridges import find_bridges, reached


@pytest.mark.parametrize("seed", range(30))
def test_bridges_are_those_of_networkx(seed: int):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 40))
    tree = networkx.random_labeled_tree(n, seed=seed)
    for _ in range(int(rng.integers(0, n))):
        i, j = (int(end) for end in rng.integers(0, n, size=2))
        if i != j:
            tree.add_edge(i, j)
    ends = np.array([sorted(edge) for edge in tree.edges])
    bridges = find_bridges(ends, n)
    found = {tuple(ends[e].tolist()) for e in bridges}
    assert found == {tuple(sorted(edge)) for edge in networkx.bridges(tree)}
    for e in bridges:
        one, other = (set(reached(np.delete(ends, e, axis=0), end, n).tolist()) for end in ends[e])
        assert one.isdisjoint(other)
        assert len(one | other) == n
