"""The optical axis of a camera of unknown mount, by its turns.

Between two pictures the body turns by a known rotation; the scene is unknown. With the right mount of the
camera, this rotation leaves the matched directions of the two pictures in planes with one direction of
travel. A wrong mount turns them about a wrong axis: a vehicle that yaws turns the picture of a down-looking
camera about its centre, and shifts that of a camera that looks ahead. If a vehicle does not turn, all mounts
explain the pictures equally well.

Source: Kneip and Lynen 2013 (ICCV, "Direct optimization of frame-to-frame rotation") for the plane of travel;
Hartley and Zisserman 2004, section 11.4.3 (Sampson's error).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from frontend.ray_pairs import RayPair

Array = NDArray[np.float64]

_MATCHES = 60
"""Matches of a pair that are compared. More of them have the same errors, those of the rotation."""
_AXES, _AXES_DOWN, _ROLLS = 40, 8, 12
"""Mounts that are tried: directions of the optical axis over the sphere, more of those that look down, and
turns about it, some 30 degrees apart. Vehicles turn by a fraction of a radian between two pictures, so that
the cost is smooth at this step."""
_REFINED, _STEP_RAD, _MOST_STEPS = 2, 0.3, 150
"""Best mounts on either side that are refined, and the first step and the length of the refinement."""
_LEAST_SCALE = 2e-4
"""Smallest error of a direction in rad: a fifth of a pixel of a lens with 1000 px focal length."""
_ROUNDS = 2
"""Rounds of weighting for a direction of travel."""
_SQRT_2, _NEAR_TRAVEL = float(np.sqrt(2.0)), 0.02
"""Both directions of a match have errors. Nearer to the direction of travel, in rad, the error of a match
says little about its plane."""


@dataclass(frozen=True)
class TurnedPair:
    """Matches of two pictures, and how the body turned between them."""

    rays: RayPair
    j_R_i: Array
    """(3, 3) from the body's axes at the first picture to those at the second."""
    block: int
    """Number of the stretch of time; errors within one are related."""


@dataclass(frozen=True)
class AxisEvidence:
    """How well the turns of pictures fit a camera that looks down."""

    by_block: Array
    """(b,) twice the logarithm of the likelihood of each stretch, of the best mount that looks down less that
    of the best one that does not."""
    tilt_rad: float
    """Angle between straight down and the optical axis of the best mount of all."""
    b_R_c: Array
    """(3, 3) the best mount that looks down."""


def axis_evidence(
    pairs: Sequence[TurnedPair], b_down: Array, most_tilt_rad: float, blocks: int
) -> AxisEvidence:
    """Compare mounts whose optical axis is within ``most_tilt_rad`` of ``b_down`` (3,) with all others."""
    misfit = _Misfit.of(pairs)
    tried: dict[bool, list[tuple[float, Array]]] = {True: [], False: []}
    for mount in _mounts(b_down, most_tilt_rad):
        looks_down = tilt_rad(mount, b_down) <= most_tilt_rad
        tried[looks_down].append((float(np.abs(misfit(mount)).sum()), mount))
    for side in tried.values():
        side.sort(key=lambda each: each[0])
    scale = misfit.scale(min((side[0] for side in tried.values()), key=lambda each: each[0])[1])
    best = {
        looks_down: min(
            (
                misfit.refined(mount, scale, lambda m: (tilt_rad(m, b_down) <= most_tilt_rad) == looks_down)  # noqa: B023
                for _, mount in side[:_REFINED]
            ),
            key=lambda each: each[0],
        )
        for looks_down, side in tried.items()
    }
    of_all = min(best.values(), key=lambda each: each[0])[1]
    scale = misfit.scale(of_all)
    better = misfit.cost(best[False][1], scale) - misfit.cost(best[True][1], scale)
    block = np.array([pair.block for pair in pairs])
    by_block = np.asarray(np.bincount(block, better, blocks), dtype=float)
    return AxisEvidence(by_block, tilt_rad(of_all, b_down), best[True][1])


def quarter_turns(b_R_c: Array) -> int:
    """Return by how many quarter turns to the left, -1 to 2, the top of the picture is off the nose (x).

    ``b_R_c`` (3, 3) is the mount of a camera that looks down.
    """
    top = -b_R_c[:, 1]
    return (round(float(np.arctan2(top[1], top[0])) / (np.pi / 2)) + 1) % 4 - 1


def top_evidence(pairs: Sequence[TurnedPair], b_R_c: Array, blocks: int) -> Array:
    """Compare a mount that looks down with the same one after the `quarter_turns` that put the nose on top.

    Return (b,) as `AxisEvidence.by_block`; zeros where the nose is at the top already.
    """
    misfit = _Misfit.of(pairs)
    back = Rotation.from_rotvec([0.0, 0.0, -np.pi / 2 * quarter_turns(b_R_c)]).as_matrix()
    scale = misfit.scale(b_R_c)
    better = misfit.cost(back @ b_R_c, scale) - misfit.cost(b_R_c, scale)
    return np.asarray(np.bincount([pair.block for pair in pairs], better, blocks), dtype=float)


def tilt_rad(b_R_c: Array, b_down: Array) -> float:
    """Return the angle between straight down (3,) and the optical axis of a mount (3, 3)."""
    return float(np.arccos(np.clip(b_R_c[:, 2] @ b_down / np.linalg.norm(b_down), -1.0, 1.0)))


@dataclass(frozen=True)
class _Misfit:
    """Errors of the matches of p pairs, n each, under a mount."""

    i_ray: Array
    """(p, n, 3) of unit length."""
    j_ray: Array
    j_R_i: Array
    """(p, 3, 3) turns of the body."""

    @staticmethod
    def of(pairs: Sequence[TurnedPair]) -> _Misfit:
        some = [pair.rays.spread(_MATCHES) for pair in pairs]
        i_ray, j_ray = np.array([each.i_ray for each in some]), np.array([each.j_ray for each in some])
        i_ray, j_ray = (ray / np.linalg.norm(ray, axis=2, keepdims=True) for ray in (i_ray, j_ray))
        return _Misfit(i_ray, j_ray, np.array([pair.j_R_i for pair in pairs]))

    def __call__(self, b_R_c: Array) -> Array:
        """Return the errors (p, n) in rad of the matches, at the best direction of travel of each pair."""
        turned = self.i_ray @ np.swapaxes(b_R_c.T @ self.j_R_i @ b_R_c, 1, 2)
        normal = np.cross(turned, self.j_ray)
        # A wrong match moves far along a line that the travel allows, and must not determine it.
        length = np.linalg.norm(normal, axis=2)
        usual = np.maximum(np.median(length, axis=1, keepdims=True), _LEAST_SCALE)
        weight = 1.0 / (1.0 + (length / usual) ** 2)
        for _ in range(_ROUNDS):
            scatter = np.einsum("pn,pni,pnj->pij", weight, normal, normal)
            travel = np.linalg.eigh(scatter)[1][:, None, :, 0]
            across = np.linalg.norm(np.cross(self.j_ray, travel), axis=2)
            size = _SQRT_2 * np.maximum(across, _NEAR_TRAVEL)
            error = (normal * travel).sum(axis=2) / size
            spread = np.maximum(np.median(np.abs(error), axis=1, keepdims=True), _LEAST_SCALE)
            weight = 1.0 / (size**2 * (1.0 + (error / spread) ** 2))
        return np.asarray(error)

    def scale(self, b_R_c: Array) -> float:
        """Return the likeliest scale of Cauchy's distribution of the errors: their median."""
        return max(float(np.median(np.abs(self(b_R_c)))), _LEAST_SCALE)

    def cost(self, b_R_c: Array, scale: float) -> Array:
        """Return (p,) the logarithm of Cauchy's likelihood of the errors, times -2."""
        return np.asarray(2.0 * np.log1p((self(b_R_c) / scale) ** 2).sum(axis=1))

    def refined(self, b_R_c: Array, scale: float, allowed: Callable[[Array], bool]) -> tuple[float, Array]:
        """Return the least cost near a mount that is allowed, and its mount."""

        def moved(turn: Array) -> Array:
            return np.asarray(b_R_c @ Rotation.from_rotvec(turn).as_matrix())

        def cost(turn: Array) -> float:
            mount = moved(turn)
            return float(self.cost(mount, scale).sum()) if allowed(mount) else np.inf

        simplex = np.vstack([np.zeros(3), _STEP_RAD * np.eye(3)])
        found = minimize(
            cost,
            np.zeros(3),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": _MOST_STEPS, "xatol": 1e-3, "fatol": 0.1},
        )
        return float(found.fun), moved(found.x)


def _mounts(b_down: Array, most_tilt_rad: float) -> Iterator[Array]:
    """Yield mounts (3, 3) of all directions; a sixth of them looks down."""
    down_R_b = Rotation.align_vectors(np.array([[0.0, 0.0, 1.0]]), b_down[None])[0]
    for axis in [*_directions(_AXES, np.pi), *_directions(_AXES_DOWN, most_tilt_rad)]:
        tip = Rotation.align_vectors(axis[None], np.array([[0.0, 0.0, 1.0]]))[0]
        for roll in np.arange(_ROLLS) * (2 * np.pi / _ROLLS):
            yield np.asarray((down_R_b.inv() * tip * Rotation.from_rotvec([0.0, 0.0, roll])).as_matrix())


def _directions(count: int, most_rad: float) -> Array:
    """Return unit vectors (n, 3) evenly over the part of the sphere within an angle of z (Fibonacci)."""
    k = np.arange(count) + 0.5
    z = 1.0 - (1.0 - np.cos(most_rad)) * k / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
