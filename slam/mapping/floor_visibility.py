"""The floor that pictures show, by the attitude: none of it where they look at the horizon or the sky."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from backend.wording import either
from frontend.camera import Camera
from frontend.views import Masks
from slam.core.flight import Flight
from slam.core.messages import about
from slam.core.rotations import rotation_of
from slam.core.streams import Image
from slam.io.down_looking import LEAST_FALL
from slam.mapping.keyframe_readings import REACH_S, attitudes_at
from slam.mapping.obstacles import no_masks

_NODES = 64
"""Nodes of a mask along the longer side of a picture: about a degree apart, finer than a gimbal's errors."""


def without_horizon_frames(flight: Flight, camera: Camera) -> Flight:
    """The flight without the attitudes by which the camera does not look at the floor; they are counted.

    A tumbling vehicle's pictures match no floor, so that a flight loses nothing with them. What is left out
    is an instrument that is broken, upside down, or of another convention.
    """
    if flight.attitude is None:
        return flight
    angles = flight.attitude.roll_pitch_yaw_rad
    away = rotation_of(angles)[:, 2] @ camera.b_T_c[:3, 2] > -LEAST_FALL  # not where an angle is missing
    if not away.any():
        return flight
    warning = about(
        "attitude0",
        f"according to {away.sum()} of {len(away)} readings the camera looks at the horizon or the sky",
        f"{either(away.sum(), 'it is', 'they are')} left out",
        f"check its angles, and T_BS in {flight.camera_file}",
    )
    left = np.where(away[:, None], np.nan, angles)
    attitude = None if away.all() else replace(flight.attitude, roll_pitch_yaw_rad=left)
    return replace(flight, attitude=attitude).with_warning(warning)


def horizon_masks(flight: Flight, camera: Camera) -> Masks:
    """Return the masks of what pictures show near the horizon and above it, by the attitude.

    Clouds, and hills that are far away, match from picture to picture as a plane at infinity does. Pictures
    that show none of it, or have no attitude, are looked at as a whole.
    """
    if flight.attitude is None or flight.frames is None:
        return no_masks
    width, height = camera.size_px
    step = max(width, height) / _NODES
    u, v = np.meshgrid(np.arange(0.5 * step, width, step), np.arange(0.5 * step, height, step))
    rays = camera.rays(camera.undistort(np.column_stack([u.ravel(), v.ravel()]))) @ camera.b_T_c[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    edge = np.zeros(u.shape, dtype=bool)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    up = rotation_of(flight.attitude.roll_pitch_yaw_rad)[:, 2]
    highest = np.full(len(up), -1.0)
    for ray in rays[edge.ravel()]:  # one by one: for an hour of readings all of them would take a gigabyte
        np.maximum(highest, up @ ray, out=highest)
    seen_s, frames_s = np.sort(flight.attitude.stamps_s[highest > -LEAST_FALL]), flight.frames.stamps_s
    first, end = (np.searchsorted(seen_s, frames_s + side_s) for side_s in (-REACH_S, REACH_S))
    near = np.flatnonzero(end > first)
    if not len(near):
        return no_masks
    found = attitudes_at(flight.attitude, frames_s[near], 0.0)
    angles = {int(near[a.k]): a.roll_pitch_yaw_rad for a in found}

    def mask(frame: int) -> Image | None:
        if frame not in angles:
            return None
        shown = rays @ rotation_of(angles[frame])[2] <= -LEAST_FALL
        if shown.all():
            return None
        nodes = 255 * shown.reshape(u.shape).astype(np.uint8)
        return np.asarray(cv2.resize(nodes, camera.size_px, interpolation=cv2.INTER_NEAREST))

    return mask


def joined(a: Masks, b: Masks) -> Masks:
    """Return masks that hide what either of two hides."""
    if no_masks in (a, b):
        return b if a is no_masks else a

    def mask(frame: int) -> Image | None:
        found = [mask for mask in (a(frame), b(frame)) if mask is not None]
        return np.minimum.reduce(found) if found else None

    return mask
