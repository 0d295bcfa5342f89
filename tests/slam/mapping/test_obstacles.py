"""Obstacles from the echoes of a simulated flight over boxes, where the truth is known."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from slam import optimize
from slam.core.flight import Flight
from slam.core.streams import Sonar
from slam.evaluation import evaluate
from slam.evaluation.association import poses_at
from slam.mapping.config import MaskingConfig, PipelineConfig
from slam.mapping.obstacles import echoes_in_map, find_obstacles, poses_between, range_contradiction
from slam.simulation.place.terrain import elevation
from slam.simulation.recipe import Recipe
from tests.slam.small_flight import flown, recipe

BOXES = [
    {"center_m": [0.9, 0.3], "size_m": [0.3, 0.3, 0.25], "heading_deg": 20.0},
    {"center_m": [1.0, 0.72], "size_m": [0.4, 0.25, 0.15]},
]
WAY = {"way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], "A", "B"], "cruise_m_s": 0.4, "height_m": 0.8}


def gym(boxes: bool = True) -> dict:
    return {"maneuver": WAY, "world": {"boxes": BOXES if boxes else [], "texture": "gym"}}


@lru_cache(maxsize=4)
def flight(boxes: bool = True) -> Flight:
    return flown(0, **gym(boxes))


def place() -> Recipe:
    return recipe(**gym())


def some_poses(over: Flight, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """True poses as keyframes have them, on a map that is too large or too small."""
    stamps_s = over.frames.stamps_s[::4]
    poses = poses_at(over.truth, stamps_s)
    poses[:, :3, 3] *= scale
    return stamps_s, poses


@pytest.mark.parametrize("scale", [1.0, 0.96, 1.05])
def test_echoes_from_boxes_are_distinguished_from_the_floor_whatever_the_scale_of_the_map(scale):
    over = flight()
    found = find_obstacles(over, over.camera, *some_poses(over, scale), 0.0, MaskingConfig())
    where = poses_at(over.truth, over.sonar.stamps_s)
    axis = -where[:, :3, 2]
    foot = where[:, :3, 3] - axis * (where[:, 2, 3] / axis[:, 2])[:, None]
    on_box = elevation(place().world, foot[:, 0], foot[:, 1]) > 0
    left_out = np.isnan(found.sonar.range_m) & np.isfinite(over.sonar.range_m)
    assert on_box.sum() > 30
    # At its edge a box is met by a ray that is tilted a little: only few readings.
    assert (left_out & on_box).sum() > 0.9 * on_box.sum()
    assert (left_out & ~on_box).sum() < 0.1 * on_box.sum()
    assert "obstacles" in found.warning.text
    masks = [found.masks(k) for k in range(len(over.frames))]
    shown = [mask for mask in masks if mask is not None]
    assert 0.3 * len(masks) < len(shown)
    assert all(0.02 < (mask == 0).mean() < 0.7 for mask in shown[::5])


def test_echoes_while_another_part_was_mapped_have_no_place():
    """They would lie on the straight way between the poses before and after it."""
    over = flight()
    stamps_s, poses = some_poses(over)
    poses[5:15] = np.nan
    found = echoes_in_map(over.sonar, stamps_s, poses, 0.0)
    meanwhile = (over.sonar.stamps_s > stamps_s[4]) & (over.sonar.stamps_s < stamps_s[15])
    np.testing.assert_array_equal(found.measured[meanwhile], False)
    assert found.measured[~meanwhile].mean() > 0.9


def test_the_map_of_heights_is_the_truths():
    over = flight()
    echoes = echoes_in_map(over.sonar, *some_poses(over), 0.0)
    made = echoes.map
    x, y = np.meshgrid(np.linspace(0.3, 1.5, 60), [0.3, 0.7])
    true, ours = elevation(place().world, x, y), made.at(x, y)
    assert np.isfinite(ours).mean() > 0.95
    off = np.abs(ours - true)[np.isfinite(ours)]
    assert np.median(off) < 0.01
    assert (off < 0.03).mean() > 0.85, "all but at the edges"
    assert echoes.floor_std_m < 0.02


def spiked(over: Flight, share: float) -> Flight:
    rng = np.random.default_rng(2)
    hit = rng.random(len(over.sonar.stamps_s)) < share
    return replace(over, sonar=replace(over.sonar, range_m=np.where(hit, 0.5, 1.0) * over.sonar.range_m))


def rounded(over: Flight, step_m: float) -> Flight:
    return replace(over, sonar=replace(over.sonar, range_m=step_m * np.round(over.sonar.range_m / step_m)))


@pytest.mark.parametrize(
    "over",
    [
        lambda: flight(boxes=False),
        lambda: spiked(flight(boxes=False), 0.05),
        lambda: rounded(flight(boxes=False), 0.1),
        lambda: replace(flight(), sonar=None),
        lambda: replace(
            flight(), sonar=replace(flight().sonar, range_m=np.full_like(flight().sonar.range_m, np.nan))
        ),
    ],
)
def test_a_flat_floor_single_spikes_and_no_sonar_are_no_obstacles(over):
    chosen = over()
    assert find_obstacles(chosen, chosen.camera, *some_poses(chosen), 0.0, MaskingConfig()) is None
    echoes = echoes_in_map(chosen.sonar, *some_poses(chosen), 0.0)
    assert echoes is None or range_contradiction(echoes, MaskingConfig()) is None


def test_a_sonar_that_reads_at_random_has_found_no_obstacles():
    """Masks of it would blind the camera; the status says that the ranges do not fit."""
    over = flight(boxes=False)
    range_m = np.random.default_rng(0).uniform(0.3, 5.3, len(over.sonar.range_m))
    broken = replace(over, sonar=replace(over.sonar, range_m=range_m))
    assert find_obstacles(broken, over.camera, *some_poses(over), 0.0, MaskingConfig()) is None
    echoes = echoes_in_map(broken.sonar, *some_poses(over), 0.0)
    assert "do not fit the map's heights over the floor" in str(range_contradiction(echoes, MaskingConfig()))


@pytest.mark.parametrize("gain", [0.75, 1.2])
def test_ranges_that_change_in_mid_flight_are_no_obstacles(gain: float):
    """Half of the flight seems to be over an obstacle, which the other visit to the same ground denies."""
    over = flight(boxes=False)
    later = over.sonar.stamps_s > 0.55 * over.sonar.stamps_s[-1]
    range_m = np.where(later, gain, 1.0) * over.sonar.range_m
    changed = replace(over, sonar=replace(over.sonar, range_m=range_m))
    assert find_obstacles(changed, over.camera, *some_poses(over), 0.0, MaskingConfig()) is None
    line = str(range_contradiction(echoes_in_map(changed.sonar, *some_poses(over), 0.0), MaskingConfig()))
    assert "over the same ground" in line or "do not fit" in line


def test_a_few_odd_ranges_at_one_visit_put_no_lengths_in_doubt():
    over = flight(boxes=False)
    odd = np.abs(over.sonar.stamps_s - 0.6 * over.sonar.stamps_s[-1]) < 0.6
    heard = replace(over.sonar, range_m=np.where(odd, 0.9, 1.0) * over.sonar.range_m)
    echoes = echoes_in_map(heard, *some_poses(over), 0.0)
    assert echoes.standing(MaskingConfig()).sum() > 10
    assert range_contradiction(echoes, MaskingConfig()) is None


def test_boxes_are_heard_at_every_visit():
    over = flight()
    assert range_contradiction(echoes_in_map(over.sonar, *some_poses(over), 0.0), MaskingConfig()) is None


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_multipath_echoes_are_not_the_floor(share: float):
    over = flight(boxes=False)
    twice = np.random.default_rng(3).random(len(over.sonar.stamps_s)) < share
    heard = replace(over.sonar, range_m=np.where(twice, 2.0, 1.0) * over.sonar.range_m)
    assert range_contradiction(echoes_in_map(heard, *some_poses(over), 0.0), MaskingConfig()) is None


def test_a_climb_that_no_keyframe_saw_is_no_obstacle():
    """Between keyframes the way is taken for straight; how high it was in a long climb nobody knows."""

    def height_m(t: np.ndarray) -> np.ndarray:
        return 0.8 + 0.8 * np.clip((t - 4) / 4, 0, 1) ** 3

    t = np.arange(0, 12, 0.04)
    sonar = Sonar(t, height_m(t))
    frequent = np.arange(0, 12.1, 0.25)
    for keyframes_s, known in ((frequent, 1.0), (frequent[(frequent <= 4) | (frequent >= 8)], 8 / 12)):
        poses = np.tile(np.eye(4), (len(keyframes_s), 1, 1))
        poses[:, 2, 3] = height_m(keyframes_s)
        echoes = echoes_in_map(sonar, keyframes_s, poses, 0.0)
        assert not echoes.standing(MaskingConfig()).any()
        assert np.isfinite(echoes.height_m).mean() == pytest.approx(known, abs=0.01)


def test_gusts_between_keyframes_are_no_obstacles():
    """Some keyframes have equal heights, between which the vehicle has sunk or climbed."""
    t, keyframes_s = np.arange(0, 20, 0.04), np.arange(0, 20.1, 0.7)

    def height_m(at_s: np.ndarray) -> np.ndarray:
        return 0.8 - 0.1 * np.cos(np.pi * at_s / 1.2) ** 2 * (at_s > 7)

    poses = np.tile(np.eye(4), (len(keyframes_s), 1, 1))
    poses[:, 2, 3] = height_m(keyframes_s)
    echoes = echoes_in_map(Sonar(t, height_m(t)), keyframes_s, poses, 0.0)
    assert not echoes.standing(MaskingConfig()).any()
    assert np.isfinite(echoes.height_m[t < 6]).all()


@pytest.mark.slow
def test_masks_that_leave_no_floor_to_see_are_dropped_and_reported(monkeypatch):
    over = flight()
    monkeypatch.setattr(
        "slam.mapping.obstacles.ObstacleMask",
        lambda *_: lambda pose: np.zeros(over.camera.size_px[::-1], np.uint8),
    )
    estimate = optimize(over)
    assert (estimate.component == 0).mean() > 0.9
    told = "hiding them from the matching would leave no map, so nothing is hidden"
    assert any(told in line for line in estimate.warnings)


def test_it_can_be_switched_off_and_set():
    over = flight()
    for off in (
        MaskingConfig(pixels=False, echoes=False),
        MaskingConfig(gamma_3_m=0.5),
        MaskingConfig(least_share=0.9),
    ):
        assert find_obstacles(over, over.camera, *some_poses(over), 0.0, off) is None
    placed_nowhere = some_poses(over)[0], np.full((len(some_poses(over)[0]), 4, 4), np.nan)
    assert find_obstacles(over, over.camera, *placed_nowhere, 0.0, MaskingConfig()) is None


def test_pixels_and_echoes_are_switched_one_by_one():
    over = flight()
    pixels, echoes = (
        find_obstacles(over, over.camera, *some_poses(over), 0.0, config)
        for config in (MaskingConfig(echoes=False), MaskingConfig(pixels=False))
    )
    np.testing.assert_array_equal(pixels.sonar.range_m, over.sonar.range_m)
    assert np.isnan(echoes.sonar.range_m).sum() > 30
    frames = range(len(over.frames))
    assert any(pixels.masks(k) is not None for k in frames)
    assert all(echoes.masks(k) is None for k in frames)
    assert "pixels" in pixels.warning.text
    assert "pixels" not in echoes.warning.text


def test_objects_below_the_least_range_are_masked_beside_measured_ones():
    """The highest box is nearer than the sonar hears: silence there; a flat floor's silence is left alone."""
    over = flight()
    deaf = replace(over, sonar=replace(over.sonar, min_range_m=0.6, range_m=silenced(over, 0.6)))
    found = find_obstacles(deaf, deaf.camera, *some_poses(deaf), 0.0, MaskingConfig())
    echoes = echoes_in_map(deaf.sonar, *some_poses(deaf), 0.0)
    assert echoes.too_near.sum() > 10
    where = echoes.w_p_m[echoes.too_near]
    assert (elevation(place().world, *where.T) > 0.2).mean() > 0.8
    x, y = np.array([0.9]), np.array([0.3])
    assert echoes.map.at(x, y)[0] == pytest.approx(0.2, abs=0.02), "at least so high: 0.8 less 0.6"
    assert found is not None
    flat = flight(boxes=False)
    lost = np.where(np.arange(len(flat.sonar.stamps_s)) % 60 < 15, np.nan, flat.sonar.range_m)
    quiet = replace(flat, sonar=replace(flat.sonar, min_range_m=0.6, range_m=lost))
    assert find_obstacles(quiet, quiet.camera, *some_poses(quiet), 0.0, MaskingConfig()) is None


def test_a_map_of_another_scale_or_heading_has_not_moved_and_a_bent_one_has():
    over = flight()
    stamps_s, poses = some_poses(over)
    found = find_obstacles(over, over.camera, stamps_s, poses, 0.0, MaskingConfig())
    turned = replace(found, w_p_m=1.1 * found.w_p_m @ np.array([[0.8, -0.6], [0.6, 0.8]]) + 3.0)
    assert not turned.moved_from(found)
    assert not found.moved_from(found)
    bent = found.w_p_m + 0.5 * np.column_stack([found.w_p_m[:, 0] ** 2, 0 * found.w_p_m[:, 0]])
    assert replace(found, w_p_m=bent).moved_from(found)
    assert not replace(found, w_p_m=np.full_like(bent, np.nan)).moved_from(found)


def silenced(over: Flight, least_m: float) -> np.ndarray:
    return np.where(over.sonar.range_m < least_m, np.nan, over.sonar.range_m)


def test_poses_between_are_on_the_way_and_not_beyond():
    over = flight()
    stamps_s, poses = some_poses(over)
    np.testing.assert_allclose(poses_between(stamps_s, poses, stamps_s), poses, atol=1e-9)
    between = poses_between(stamps_s, poses, over.frames.stamps_s)
    np.testing.assert_allclose(
        between[2, :3, 3], poses_at(over.truth, over.frames.stamps_s[2:3])[0, :3, 3], atol=0.03
    )
    assert np.isnan(poses_between(stamps_s, poses, stamps_s[[0, -1]] + [-1, 1])).all()


@pytest.mark.slow
def test_a_flat_flight_is_mapped_as_before_and_has_its_elevation():
    over = flight(boxes=False)
    on, off = (
        optimize(over, PipelineConfig(masking=MaskingConfig(pixels=e, echoes=e))) for e in (True, False)
    )
    np.testing.assert_array_equal(on.w_T_b, off.w_T_b)
    assert np.nanpercentile(np.abs(on.elevation.height_m), 95) < 0.03
    assert optimize(replace(over, sonar=None)).elevation is None


@pytest.mark.slow
def test_masking_halves_the_error_of_a_map_over_boxes():
    over = flight()
    error = {}
    for enabled in (True, False):
        estimate = optimize(over, PipelineConfig(masking=MaskingConfig(pixels=enabled, echoes=enabled)))
        error[enabled] = evaluate(estimate, over).ate_m.rmse
        assert any("obstacles" in line for line in estimate.warnings) == enabled
    assert error[True] < 0.5 * error[False], error
    assert error[True] < 0.01
