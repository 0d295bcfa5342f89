"""The pictures of a flight, rendered reproducibly on each access."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.simulation.camera import photometry, shutter
from slam.simulation.camera.effects import CameraEffects, true_camera
from slam.simulation.camera.optics import SUPERSAMPLING, CameraModel, sample
from slam.simulation.chance import generator
from slam.simulation.place.reflections import add_reflection
from slam.simulation.place.scene import build_scene
from slam.simulation.place.world import Marks, World

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Film:
    """Renderer of the pictures of a flight, without dropped ones."""

    world: World
    marks: Marks
    model: CameraModel
    effects: CameraEffects
    numbers: NDArray[np.int64]
    """(n,) index among all pictures taken, so that dropped pictures do not change the others."""
    stamps_s: Array
    """(n,) stamps."""
    w_T_b: Array
    """(n, m, 4, 4) true poses of the body at the ``shutter.moments`` of each picture."""
    tones: Array
    """(n, 4) gains and gamma."""
    seed: int

    @property
    def nominal_camera(self) -> Camera:
        """The camera as the flight reports it."""
        return self.model.camera()

    @cached_property
    def _camera(self) -> Camera:
        return true_camera(self.nominal_camera, self.effects)

    def __call__(self, k: int) -> Image:
        """Render picture k as (h, w, 3) BGR."""
        camera = self._camera
        light = self._light(k)
        model, effects = self.model, self.effects
        if effects.vignetting > 0:
            darker = photometry.falloff(camera.size_px, camera.center_px, effects.vignetting)
            light = light.astype(np.float32, copy=False) * darker[..., None]
        if (model.saturation, model.brightness) != (1.0, 1.0):
            light = photometry.process(
                light.astype(np.float32, copy=False), model.saturation, model.brightness
            )
        if effects.gain_std > 0 or effects.gamma_std > 0:
            light = photometry.apply_tone(light.astype(np.float32, copy=False), self.tones[k])
        return photometry.digitise(
            light, model.noise_std, generator(self.seed, "camera", int(self.numbers[k]))
        )

    def _light(self, k: int) -> Image | NDArray[np.float32]:
        """Return the light on the sensor: the mean over the exposure, each row at its own time."""
        camera, effects = self._camera, self.effects
        scene = build_scene(self.world, self.marks, effects.moving_objects, self.seed)
        prisms = scene.prisms(float(self.stamps_s[k]) - effects.time_offset_s)
        w_T_c = self.w_T_b[k] @ camera.b_T_c
        count = shutter.parts(w_T_c, camera.focal_px[0], effects)
        mean = None
        for part in range(count):
            w_R_c, w_t_c = shutter.row_poses(w_T_c, camera.size_px[1], part, count, effects)
            if len(w_t_c) > 1:
                w_R_c, w_t_c = (np.repeat(pose, SUPERSAMPLING, axis=0) for pose in (w_R_c, w_t_c))
            samples = sample(scene, camera, w_R_c, w_t_c, prisms)
            if effects.highlight > 0:
                middle = len(w_t_c) // 2
                add_reflection(
                    samples, camera, SUPERSAMPLING, w_R_c[middle], w_t_c[middle], effects.highlight
                )
            picture = _pixels(samples, camera.size_px, self.model.down_sampling)
            if count == 1:
                return picture
            mean = np.zeros(picture.shape, np.float32) if mean is None else mean
            cv2.accumulateWeighted(picture, mean, 1 / (part + 1))
        assert mean is not None
        return mean


def _pixels(samples: Image, size_px: tuple[int, int], down_sampling: float) -> Image:
    """Average the samples to pixels; ``down_sampling`` uses larger pixels and scales the picture up again."""
    if down_sampling == 1:
        return np.asarray(cv2.resize(samples, size_px, interpolation=cv2.INTER_AREA))
    coarse = (max(1, round(size_px[0] / down_sampling)), max(1, round(size_px[1] / down_sampling)))
    fewer = cv2.resize(samples, coarse, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(fewer, size_px, interpolation=cv2.INTER_LINEAR))


def film_flight(
    world: World,
    marks: Marks,
    model: CameraModel,
    effects: CameraEffects,
    stamps_s: Array,
    pose_at: Callable[[Array], Array],
    duration_s: float,
    seed: int,
) -> Film:
    """Return the film of a flight with pictures stamped ``stamps_s`` (n,), without dropped ones.

    ``pose_at`` gives the true w_T_b (m, 4, 4) at times (m,) from 0 to ``duration_s``. The film keeps at least
    one picture; its ``stamps_s`` are those of the kept pictures.
    """
    tones = photometry.tones(
        stamps_s, effects.gain_std, effects.gamma_std, effects.tone_time_s, generator(seed, "tones")
    )
    kept = generator(seed, "dropped frames").uniform(size=len(stamps_s)) >= effects.dropped_share
    kept[0] |= not kept.any()
    times_s = shutter.moments(stamps_s[kept], effects, duration_s)
    w_T_b = pose_at(times_s.ravel()).reshape(*times_s.shape, 4, 4)
    return Film(
        world=world,
        marks=marks,
        model=model,
        effects=effects,
        numbers=np.flatnonzero(kept),
        stamps_s=stamps_s[kept],
        w_T_b=w_T_b,
        tones=tones[kept],
        seed=seed,
    )
