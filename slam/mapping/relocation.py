"""Position of one more picture in a map that exists already.

The map's keyframes that look most like the picture are registered to it; their features are points of the
floor, and the camera is resected from those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from backend import se3
from frontend.camera import Camera
from frontend.features import Features, check_picture
from frontend.loops import appearance
from frontend.registration import Registration, register
from frontend.store import FeatureStore
from slam.core.arguments import check_estimate, check_flight
from slam.core.errors import InputError
from slam.core.estimate import Estimate, over_floor
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.core.streams import Image
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import extractor_of

Array = NDArray[np.float64]

_ROUNDS = 3
_FAR_SIGMAS = 4.0
"""A floor point that lies farther off than this after a round is left out of the next."""


@dataclass(frozen=True)
class Location:
    """Pose of a picture in the map, or the reason why it is unknown."""

    w_T_b: Array
    """(4, 4) in the map's world; NaN where not found."""
    covariance: Array
    """(6, 6), rotation first, right perturbation: sum of the resection's and of the keyframe's."""
    keyframes: tuple[int, ...]
    """Keyframes that the picture was registered to, the one with the most matches first."""
    points: int
    """Floor points that the pose rests on."""
    reason: str
    """Empty where it was found."""

    @property
    def found(self) -> bool:
        """Whether there is a pose."""
        return not self.reason


class Relocalizer:
    """A map made ready to be asked: features and signatures of its placed keyframes."""

    def __init__(
        self,
        estimate: Estimate,
        flight: Flight,
        config: PipelineConfig = PipelineConfig(),
        progress: Progress = silent,
    ) -> None:
        """``flight``: the pictures that the map was made of.

        Raises ``InputError`` where the two do not belong together, or where OpenCV lacks the configured
        features.
        """
        check_estimate(estimate)
        check_flight(flight)
        camera = estimate.camera or flight.camera
        if camera is None or flight.frames is None:
            raise InputError(
                f"{flight.name}: no camera in this flight; give the one that the map was made of"
            )
        known = dict(zip(flight.frames.names, range(len(flight.frames)), strict=True))
        placed = np.flatnonzero(estimate.component == 0)
        if missing := [n for n in (estimate.frame_names[k] for k in placed) if n not in known]:
            raise InputError(
                f"{flight.name}: has no picture {missing[0]}, which is a keyframe of the map; "
                "give the flight that the map was made of"
            )
        self.camera, self.config = camera, config
        self._homography = config.homography.for_width(camera.size_px[0])
        self._extractor = extractor_of(config, camera)
        self._slope, self._floor_z_m = estimate.floor_slope_rad, estimate.floor_z_m
        self._store, numbers = FeatureStore(), []
        for done, k in enumerate(placed.tolist(), 1):
            image = flight.frames.load(known[estimate.frame_names[k]])
            if image is not None:
                self._store.append(self._extractor(image, camera))
                numbers.append(k)
            progress("index", done, len(placed))
        if not numbers:
            raise InputError(f"{flight.name}: none of the map's pictures can be read")
        self._numbers = np.array(numbers)
        self._over_floor = estimate.over_floor_T_b[self._numbers]
        self._covariances = estimate.covariances[self._numbers]
        self._appearance = appearance(self._store, config.retrieval)
        looks = [self._appearance.of(self._store[k].descriptor) for k in range(len(numbers))]
        self._signatures = np.array(looks)

    def locate(self, image: Image) -> Location:
        """Locate a picture of the map's camera, (h, w) grey or (h, w, 3) BGR uint8.

        Raises ``TypeError`` or ``ValueError`` for what is no such picture.
        """
        check_picture(image)
        if image.shape[1::-1] != tuple(self.camera.size_px):
            w, h = self.camera.size_px
            return nowhere(
                f"the picture has {image.shape[1]}x{image.shape[0]} px, the map's camera {w}x{h}; take it "
                "at that size"
            )
        seen = self._extractor(image, self.camera)
        if len(seen) < self.config.gates.min_inliers:
            return nowhere(
                f"too few features: {len(seen)}; take it with more light, or over ground with texture"
            )
        registered = self._registered(seen)
        if not registered:
            return nowhere(
                "no keyframe that looks like it shows the same ground; take it over the map, at its height"
            )
        w_p, pixel, std_px = self._floor_points(registered, seen)
        resected = _resect(w_p, pixel, std_px, self.camera)
        if resected is None:
            return nowhere(
                "no pose explains where the floor's points appear; take it looking down at flat ground"
            )
        f_T_b, covariance, points = resected
        best = registered[0].i
        of_map = self._covariances[best]
        if np.isfinite(of_map).all():
            carried = se3.adjoint(se3.inverse(f_T_b) @ self._over_floor[best])
            covariance = covariance + carried @ of_map @ carried.T
        back = (-self._slope[0], -self._slope[1])
        w_T_b = over_floor(f_T_b[None], back, self._floor_z_m)[0]
        return Location(w_T_b, covariance, tuple(int(self._numbers[r.i]) for r in registered), points, "")

    def _registered(self, seen: Features) -> list[Registration]:
        """Registrations to the keyframes that look alike, most matches first."""
        likeness = self._signatures @ self._appearance.of(seen.descriptor)
        alike = np.argsort(-likeness, kind="stable")[: self.config.retrieval.neighbours].tolist()
        settings = self.camera, self._homography, self.config.gates
        found = [register(i, len(self._store), self._store[i], seen, *settings) for i in alike]
        return sorted((r for r in found if r.ok), key=lambda r: -len(r.matches))

    def _floor_points(self, registered: Sequence[Registration], seen: Features) -> tuple[Array, Array, Array]:
        """Points of the floor (m, 3), where the picture shows them (m, 2), noise (m,); each feature once."""
        points, pixels, noise, known = [], [], [], np.zeros(len(seen), bool)
        for r in registered:
            unseen = ~known[r.matches[:, 1]]
            ours, theirs = r.matches[unseen].T
            known[theirs] = True
            on_floor = self.camera.floor_points(
                self._over_floor[r.i], self._store[r.i].pixel[ours], self._floor_z_m
            )
            points.append(np.column_stack([on_floor, np.full(len(ours), self._floor_z_m)]))
            pixels.append(seen.pixel[theirs])
            noise.append(r.noise_px * seen.points.spread[theirs])
        w_p = np.concatenate(points)
        usable = np.isfinite(w_p).all(axis=1)
        return w_p[usable], np.concatenate(pixels)[usable], np.concatenate(noise)[usable]


def relocalize(
    image: Image, estimate: Estimate, flight: Flight, config: PipelineConfig = PipelineConfig()
) -> Location:
    """Locate one picture in the map of a flight; for many pictures keep a `Relocalizer`.

    Raises ``InputError`` where the map was not made of this flight, and as `Relocalizer.locate` does.
    """
    return Relocalizer(estimate, flight, config).locate(image)


def nowhere(reason: str) -> Location:
    """No pose, and why."""
    return Location(np.full((4, 4), np.nan), np.full((6, 6), np.nan), (), 0, reason)


def _resect(w_p: Array, pixel: Array, std_px: Array, camera: Camera) -> tuple[Array, Array, int] | None:
    """Body pose from points of a plane in undistorted pixels, its covariance, and how many points agree.

    Source: Collins and Bartoli 2014 (planar start); Hartley and Zisserman 2004, section 7.2.
    """
    none = np.zeros(4)
    keep = np.ones(len(w_p), bool)
    pose = None
    for _ in range(_ROUNDS):
        if keep.sum() < 6:
            return None
        # About the points' own centre: far from a map's origin OpenCV's start loses digits.
        centre = w_p[keep].mean(axis=0)
        local = w_p - centre
        ok, turn, shift = cv2.solvePnP(local[keep], pixel[keep], camera.matrix, none, flags=cv2.SOLVEPNP_IPPE)
        if not ok:
            return None
        turn, shift = cv2.solvePnPRefineLM(local[keep], pixel[keep], camera.matrix, none, turn, shift)
        shown, jacobian = cv2.projectPoints(local, turn, shift, camera.matrix, none)
        off = np.linalg.norm(shown.reshape(-1, 2) - pixel, axis=1) / std_px
        spread = max(1.0, float(np.median(off[keep])) / 1.1774)
        pose, used = (turn, shift, centre, jacobian, spread), keep
        keep = off < _FAR_SIGMAS * spread
    assert pose is not None
    turn, shift, centre, jacobian, spread = pose
    c_T_w = np.eye(4)
    c_T_w[:3, :3], c_T_w[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel() - cv2.Rodrigues(turn)[0] @ centre
    w_T_b = se3.inverse(c_T_w) @ se3.inverse(camera.b_T_c)
    if w_T_b[2, 3] <= centre[2]:
        return None
    return w_T_b, _covariance(w_T_b, w_p[used], std_px[used] * spread, camera), int(used.sum())


def _covariance(w_T_b: Array, w_p: Array, std_px: Array, camera: Camera) -> Array:
    """(6, 6) of a right perturbation, from how the pixels move with it."""

    def shown(pose: Array) -> Array:
        c_p = (np.column_stack([w_p, np.ones(len(w_p))]) @ se3.inverse(pose @ camera.b_T_c).T)[:, :3]
        return np.asarray(c_p[:, :2] / c_p[:, 2:] * np.array(camera.focal_px))

    nudge = 1e-6
    ends = [(shown(w_T_b @ se3.exp(step)), shown(w_T_b @ se3.exp(-step))) for step in nudge * np.eye(6)]
    columns = [(after - before) / (2 * nudge) for after, before in ends]
    J = np.stack(columns, axis=2) / std_px[:, None, None]
    return np.asarray(np.linalg.inv(np.einsum("mar,mas->rs", J, J)))
