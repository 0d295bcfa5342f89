"""What is in memory while a refined map is solved for the errors of what it holds."""

from __future__ import annotations

import gc
from collections.abc import Callable

import pytest
from scipy.sparse import csr_array

from backend.bundle.accuracy.information_shares import information_shares
from backend.bundle.accuracy.refined_points import metric_point_stds
from backend.bundle.accuracy.systematic_errors import error_test
from backend.bundle.position_steps import position_step
from backend.bundle.reduced_system import LinearSystem
from backend.bundle.refinement import Bundle, refine
from backend.sparse_cholesky import Cholesky
from tests.backend.bundle.made_scenes import HELD_BY_POSITIONS
from tests.backend.made_floor import make


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    made = make(HELD_BY_POSITIONS, 0)
    return refine(made.measurements, made.start, made.floor_z_m)


@pytest.fixture
def in_memory(monkeypatch: pytest.MonkeyPatch) -> list[list[object]]:
    """All objects at each solve with a factor."""
    solve, found = Cholesky.solve, list[list[object]]()

    def seen(self: Cholesky, right: object) -> object:
        found.append(gc.get_objects())
        return solve(self, right)  # type: ignore[arg-type]

    monkeypatch.setattr(Cholesky, "solve", seen)
    gc.collect()
    return found


@pytest.mark.parametrize(
    "solves",
    [
        lambda bundle: metric_point_stds(bundle.optimum),
        lambda bundle: information_shares(bundle.optimum),
        lambda bundle: error_test(bundle.optimum, bundle.covariances),
    ],
    ids=["points", "shares", "errors"],
)
def test_the_jacobian_is_not_in_memory_as_a_whole(
    bundle: Bundle, solves: Callable[[Bundle], object], in_memory: list[list[object]]
) -> None:
    linear = bundle.optimum.linearise()
    whole = linear.jacobian()[0].shape
    del linear
    solves(bundle)
    assert in_memory
    assert not [each for each in in_memory[0] if isinstance(each, csr_array) and each.shape == whole]
    assert sum(isinstance(each, LinearSystem) for each in in_memory[0]) == 1


def test_steps_keep_no_linear_system_beside_its_factor(bundle: Bundle, in_memory: list[list[object]]) -> None:
    position_step(bundle.optimum)
    assert in_memory
    assert not [each for each in in_memory[0] if isinstance(each, LinearSystem)]
