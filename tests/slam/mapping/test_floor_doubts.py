"""Floors that repeat and second motions: what leaves the floor's motion open is told, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.streams import Frames
from slam.mapping.config import PipelineConfig
from slam.mapping.floor_doubts import FloorDoubts, floor_doubts
from slam.mapping.front_end import FrontEnd

CAMERA = Camera(focal_px=(110.0, 110.0), center_px=(71.5, 47.5), size_px=(144, 96))
PERIOD, SIZE = 48, 576
"""Of the floor, in its own pixels: it goes on beyond its edge."""
ZOOM = 0.9875
"""Pixels of a picture for one of the floor: copies do not lie alike between the pixels."""

Place = Callable[[int], Sequence[float]]
"""Function of a picture: where its first pixel lies on the floor."""


def floor(seed: int, period: int = SIZE) -> np.ndarray:
    """Blurred noise that repeats."""
    noise = np.random.default_rng(seed).normal(0, 1, (period, period)).astype(np.float32)
    wide = np.pad(noise, 20, mode="wrap")
    soft = (cv2.GaussianBlur(wide, (0, 0), 1.5) + cv2.GaussianBlur(wide, (0, 0), 4.0))[20:-20, 20:-20]
    shown = np.clip(128 + 45 * (soft - soft.mean()) / soft.std(), 0, 255).astype(np.uint8)
    return np.tile(shown, (SIZE // period,) * 2)


def seen(ground: np.ndarray, at: Sequence[float]) -> np.ndarray:
    (x, y), (w, h) = at, CAMERA.size_px
    column, row = np.meshgrid((np.arange(w) + x) / ZOOM % SIZE, (np.arange(h) + y) / ZOOM % SIZE)
    where = column.astype(np.float32), row.astype(np.float32)
    return cv2.remap(ground, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def doubts(
    ground: np.ndarray,
    place: Place,
    beside: Place | None = None,
    share: float = 0.5,
    count: int = 11,
    are_photographs: bool = False,
) -> FloorDoubts:
    """Track pictures of a floor, of which another one covers a ``share`` that lies ``beside``."""
    rng, other = np.random.default_rng(1), floor(9)

    def load(k: int) -> np.ndarray:
        picture = seen(ground, place(k)).astype(float)
        if beside is not None:
            edge = round(share * CAMERA.size_px[0])
            picture[:, :edge] = seen(other, beside(k))[:, :edge]
        noisy = picture + rng.normal(0, 2, picture.shape)
        return np.clip(noisy, 0, 255).astype(np.uint8)

    frames = Frames(0.5 * np.arange(count), tuple(f"{k}.png" for k in range(count)), load)
    front_end = FrontEnd(
        Flight("made", camera=CAMERA, frames=frames, all_keyframes=are_photographs),
        CAMERA,
        PipelineConfig(),
        silent,
    )
    return floor_doubts(front_end.track(), front_end)


def onward(step_px: float) -> Place:
    """Fly straight on."""
    return lambda k: (100 + step_px * k, 200 + 0.2 * step_px * k)


def to_and_fro(k: int) -> tuple[float, float]:
    """Fly there and back, so that only ground at another height moves in proportion."""
    return 100 + 20 * np.sin(k / 3), 200 + 60 * np.cos(k / 3)


@pytest.mark.parametrize(("step_px", "count", "is_open"), [(4, 40, False), (18, 11, True), (34, 11, True)])
def test_a_floor_that_repeats_is_open_where_a_step_may_be_that_of_a_copy(step_px, count, is_open):
    found = doubts(floor(2, PERIOD), onward(step_px), count=count)
    assert found.repeating is not None
    assert len(found.repeating.keyframes) > 0.7 * found.repeating.looked_at
    assert np.median(found.repeating.period_px) == pytest.approx(ZOOM * PERIOD, abs=0.5)
    assert found.are_open == is_open


def test_a_floor_that_does_not_repeat_has_no_doubt():
    found = doubts(floor(2), onward(18))
    assert found.is_floor_known
    assert not found.are_open


@pytest.mark.parametrize("share", [0.4, 0.6, 0.75])
def test_a_large_thing_that_moves_by_itself_may_be_the_floor(share):
    found = doubts(floor(2), to_and_fro, lambda k: (200 + 9.0 * k, 50 - 4.0 * k), share)
    assert found.two_motions is not None
    assert len(found.two_motions.frames) > 3
    assert found.are_open


@pytest.mark.parametrize("beside", [lambda k: (200, 50), lambda k: 1.25 * np.array(to_and_fro(k))])
def test_what_is_fixed_to_the_camera_and_ground_at_another_height_belong(beside):
    assert doubts(floor(2), to_and_fro, beside, 0.4).is_floor_known


def test_photographs_have_no_prediction_so_that_even_short_steps_add_up():
    found = doubts(floor(2, PERIOD), onward(4), are_photographs=True)
    assert found.repeating.wrong > 0.5
