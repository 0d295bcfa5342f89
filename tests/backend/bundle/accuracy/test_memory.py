"""What is in memory while a refined map is solved for the errors of what it holds."""

from __future__ import annotations

import gc
from collections.abc import Callable

import pytest

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


@pytest.mark.parametrize(
    "solves",
    [
        lambda bundle: metric_point_stds(bundle.optimum),
        lambda bundle: information_shares(bundle.optimum),
        lambda bundle: position_step(bundle.optimum),
        lambda bundle: error_test(bundle.optimum, bundle.covariances),
    ],
    ids=["points", "shares", "steps", "errors"],
)
def test_the_linear_system_is_not_kept_beside_its_factor(
    bundle: Bundle, solves: Callable[[Bundle], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    solve, alive = Cholesky.solve, []

    def counted(self: Cholesky, right: object) -> object:
        alive.append(sum(isinstance(each, LinearSystem) for each in gc.get_objects()))
        return solve(self, right)  # type: ignore[arg-type]

    monkeypatch.setattr(Cholesky, "solve", counted)
    gc.collect()
    solves(bundle)
    assert alive
    assert alive[0] == 0
