"""Something else than the floor fills a third of the pictures: the map stands, and the pilot is told."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slam.core.streams import Frames
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "contrast"), [("fixed", 20), ("fixed", 50), ("passing", 50), ("now and then", 20)]
)
def test_a_third_of_the_picture_moves_by_itself(kind: str, contrast: int) -> None:
    """Fixed to the camera, passing by, and coming and going; as rich in texture as the floor and richer."""
    eight = load_recipe("figure_eight")
    flight = simulate(replace(eight, camera=replace(eight.camera, rate_hz=7.5)), 0)
    frames = flight.frames
    assert frames is not None
    noise = cv2.GaussianBlur(
        np.random.default_rng(5).integers(0, 256, (600, 600, 3)).astype(np.float32), (0, 0), 1.5
    )
    pattern = np.clip(128 + contrast * (noise - noise.mean()) / noise.std(), 0, 255).astype(np.uint8)

    def load(k: int) -> np.ndarray:
        picture = frames.load(k).copy()
        h, w = picture.shape[:2]
        if kind == "fixed":
            picture[:, : w // 3] = pattern[:h, : w // 3]
        elif kind == "passing":
            x, y = 4 * k % 300, int(100 + 80 * np.sin(k / 9))
            picture[:, : w // 3] = pattern[y : y + h, x : x + w // 3]
        elif k // 40 % 2:  # comes at the left and goes to the right
            x, at = 6 * k % 300, k % 40 * w // 40
            picture[:, at : at + w // 3] = pattern[:h, x : x + min(w // 3, w - at)]
        return picture

    estimate = optimize(replace(flight, frames=Frames(frames.stamps_s, frames.names, load)))
    assert any("pictures something moves by itself" in line for line in estimate.warnings)
    placed = estimate.component >= 0
    assert placed.mean() > 0.97
    assert evaluate(estimate, flight).ate_m.rmse < 0.01
