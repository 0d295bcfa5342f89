"""Floors of equal tiles and a belt that fills half of the pictures: told, or right by the instruments."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown, seeing

TILE_M, BELT_M_S, BELT_FROM_M = 0.3, 0.3, 0.3
METRES_PER_PX = 0.004


def without_motion(flight: Flight) -> Flight:
    """The flight without instruments that tell its motion over the floor."""
    return replace(flight, imu=None, velocity=None)


def error_m(estimate: Estimate, flight: Flight) -> float:
    found = evaluate(estimate, flight).ate_m
    assert found is not None
    return found.rmse


def tiled() -> Flight:
    """Two pictures a second over tiles of 0.3 m, at 0.4 m/s."""
    world = {"repeat": True, "tile_m": TILE_M, "mark_diameter_m": 0.0, "metres_per_px": 0.002}
    return flown(0, world=world, camera={"rate_hz": 2.0})


def over_belt() -> Flight:
    """There and back along a belt that fills half of the pictures."""
    flight = flown(0, maneuver={"way_points": ["A", "B", "A"]})
    floor, belt = (_texture(seed) for seed in range(2))
    w, h = flight.camera.size_px
    pixel = np.stack([*np.meshgrid(np.arange(w), np.arange(h)), np.ones((h, w))])
    stamps_s, truth = flight.frames.stamps_s, flight.truth

    def load(k: int) -> np.ndarray:
        w_T_b = truth.w_T_b[min(np.searchsorted(truth.stamps_s, stamps_s[k]), len(truth.w_T_b) - 1)]
        x, y, z = np.einsum("ij,jhw->ihw", flight.camera.floor_H_image(w_T_b), pixel)
        x, y = x / z, y / z
        on_belt = y > BELT_FROM_M
        x = x - on_belt * BELT_M_S * (stamps_s[k] - stamps_s[0])
        column, row = (((axis + 1.5) / METRES_PER_PX % 1000).astype(np.float32) for axis in (x, y))
        shown = [
            cv2.remap(each, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            for each in (floor, belt)
        ]
        picture = np.where(on_belt, shown[1], shown[0]) + np.random.default_rng(k).normal(0, 2, (h, w))
        return np.repeat(np.clip(picture, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)

    return seeing(flight, load)


def _texture(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 1, (1000, 1000)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0) + cv2.GaussianBlur(noise, (0, 0), 5.0)
    return np.asarray(128 + 40 * (soft - soft.mean()) / soft.std())


@pytest.mark.slow
def test_tiles_are_told_apart_by_the_velocity_or_not_at_all() -> None:
    flight = tiled()
    estimate = optimize(flight)
    assert estimate.status == "ok"
    assert error_m(estimate, flight) < 0.01
    assert any("the floor repeats every 0.3 m" in line for line in estimate.warnings)
    alone = without_motion(flight)
    estimate = optimize(alone)
    assert "the floor repeats every 0.3 m" in estimate.status
    assert error_m(estimate, alone) > TILE_M


@pytest.mark.slow
def test_a_belt_is_told_from_the_floor_by_the_velocity_or_not_at_all() -> None:
    flight = over_belt()
    estimate = optimize(flight)
    assert estimate.status == "ok"
    assert error_m(estimate, flight) < 0.01
    assert "two motions were seen" in optimize(without_motion(flight)).status
