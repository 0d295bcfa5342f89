"""Fingerprints identify tiles that a change does not affect."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from frontend.mosaic.canvas import Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.render import RenderedTile, render_tiles
from frontend.mosaic.window import window_of
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, photograph, pose, smooth_floor, survey

Drawn = dict[tuple[int, int], RenderedTile]
POSES = survey(3, rows=3, cols=6)


@cache
def views() -> list[np.ndarray]:
    return [photograph(smooth_floor(1), CAMERA, T, 1) for T in POSES]


def planned(poses: np.ndarray = POSES, gsd_m: float = 0.01, tile_px: int = 64) -> MosaicPlan:
    return dataclasses.replace(plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m), tile_px=tile_px)


def drawn(
    plan: MosaicPlan,
    shown: list[np.ndarray] | None = None,
    exposure: Exposure | None = None,
    old: Drawn | None = None,
) -> Drawn:
    """Return all tiles by their position in the grid; those of ``old`` with the same fingerprint are kept."""
    known = {done.fingerprint: done.rgba for done in (old or {}).values()}
    done = render_tiles(
        plan, Pictures(plan, (shown or views()).__getitem__), exposure or Exposure.neutral(len(plan.views)),
        earlier=lambda tile, mark: known.get(mark),
    )  # fmt: skip
    return {(plan.first_row + d.tile.row, plan.first_col + d.tile.col): d for d in done}


@cache
def drawn_first() -> Drawn:
    return drawn(planned())


def test_unchanged_mosaic_renders_no_tile() -> None:
    first = drawn_first()
    assert len(first) > 20
    assert not any(done.reused for done in first.values())
    again = drawn(planned(), old=first)
    assert all(done.reused for done in again.values())


@pytest.mark.parametrize(
    "moved", [pytest.param(0, marks=pytest.mark.slow), 8, pytest.param(17, marks=pytest.mark.slow)]
)
def test_a_moved_picture_renders_only_the_tiles_that_it_affects(moved: int) -> None:
    poses = POSES.copy()
    poses[moved, 0, 3] += 0.02
    first, plan = drawn_first(), planned(poses)
    again, whole = drawn(plan, old=first), drawn(plan)
    for place, done in again.items():
        np.testing.assert_array_equal(done.rgba, whole[place].rgba)
        if done.reused:
            np.testing.assert_array_equal(done.rgba, first[place].rgba)
    # Footprints before and after, wider by a margin that blending and the owners' smoothing reach.
    touched = np.concatenate([CAMERA.footprint(T[moved], FLOOR_Z_M) for T in (POSES, poses)])
    west, south, east, north = *touched.min(axis=0), *touched.max(axis=0)
    for done in again.values():
        w = window_of(done.tile)
        margin = 5 * 16
        x0, x1 = ((plan.first_col + w.col + d) * plan.gsd_m for d in (-margin, w.cols + margin))
        y1, y0 = (-(plan.first_row + w.row + d) * plan.gsd_m for d in (-margin, w.rows + margin))
        if x1 < west or x0 > east or y1 < south or y0 > north:
            assert done.reused
    kept = sum(done.reused for done in again.values())
    assert 0.2 * len(again) < kept < len(again)


def test_an_added_picture_keeps_the_tiles_that_it_does_not_affect() -> None:
    poses = np.concatenate([POSES, [pose(5.5, 0.0, 2.0)]])
    longer = [*views(), photograph(smooth_floor(1), CAMERA, poses[-1], 1)]
    first, plan = drawn_first(), planned(poses)
    again, whole = drawn(plan, longer, old=first), drawn(plan, longer)
    assert sum(done.reused for done in again.values()) > 0.5 * len(first)
    for place, done in again.items():
        np.testing.assert_array_equal(done.rgba, whole[place].rgba)


@pytest.mark.slow
def test_a_change_of_shared_inputs_renders_all_tiles() -> None:
    plan, first = planned(), drawn_first()
    neutral = Exposure.neutral(len(plan.views))
    darker = dataclasses.replace(neutral, vignette=np.full((2, 3), 0.1))
    lens = dataclasses.replace(CAMERA, distortion=(1e-3, 0.0, 0.0, 0.0))
    for again in (
        drawn(planned(gsd_m=0.0101), old=first),
        drawn(dataclasses.replace(plan, camera=lens), old=first),
        drawn(plan, exposure=darker, old=first),
        drawn(plan, [255 - view for view in views()], old=first),
        drawn(planned(tile_px=96), old=first),
    ):
        shown = [done for done in again.values() if done.rgba.any()]
        assert not any(done.reused for done in shown)


def test_gain_and_content_of_one_picture_affect_only_its_tiles() -> None:
    plan, first = planned(), drawn_first()
    gain = np.ones((len(plan.views), 3))
    gain[0, 1] = 1.01
    brighter = dataclasses.replace(Exposure.neutral(len(plan.views)), gain=gain)
    k = plan.views[0].k
    negative = [np.where(n == k, 255 - view, view) for n, view in enumerate(views())]
    for again in (drawn(plan, exposure=brighter, old=first), drawn(plan, negative, old=first)):
        changed = {place for place, done in again.items() if (done.rgba != first[place].rgba).any()}
        rendered = {place for place, done in again.items() if not done.reused}
        assert changed <= rendered
        assert 0 < len(rendered) < len(first)


def test_window_is_whole_cells() -> None:
    assert window_of(Tile(0, 32, 50, 64)) == Tile(-64, -32, 64 + 128, 64 + 128)
