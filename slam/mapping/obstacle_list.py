"""The obstacles of a finished map, in one list: by raised floor points, and by echoes of the sonar."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from backend.bundle.accuracy.refined_points import metric_points
from backend.bundle.refinement import Bundle
from frontend.elevation import NEAREST, Elevation, elevation_map
from frontend.obstacles import ObstacleList, standing_on
from slam.core.streams import Sonar
from slam.mapping.config import MaskingConfig
from slam.mapping.map import Map
from slam.mapping.obstacles import RELATIVE_GAMMA, Echoes, echoes_in_map, hears_obstacles

RELIEF_SIGMAS = 3.0
"""Standard deviations of the relief within which ground is no obstacle."""
_LEAST_VIEWS = 2
"""Views without which a point has no place."""
_CELLS_A_DISTANCE = 2
"""Cells within the distance that a point stands for: points are no denser."""


def map_elevation(refined: Map, sonar: Sonar | None) -> Elevation | None:
    """Return the ground by the echoes of all parts in the world of the largest one; None without any."""
    heard = _echoes(refined, sonar, refined.world == 0)
    return None if heard is None else heard.map


def map_obstacles(refined: Map, sonar: Sonar | None, config: MaskingConfig) -> ObstacleList | None:
    """Return what stands on the ground of the largest part; None where nothing would show it.

    Echoes of other parts do not count: a part may have a world of its own, whose places are not those of the
    largest, or a floor that is less level.
    """
    found = None if refined.bundle is None else obstacles_by_points(refined.bundle, refined.metric, config)
    echoes = _echoes(refined, sonar, refined.component == 0)
    if echoes is None or not (config.pixels or config.echoes) or not hears_obstacles(echoes, config):
        return found
    heard = echoes.map
    assert heard is not None
    by_echoes = standing_on(heard, echoes.gamma_m(config), {"sonar": np.isfinite(heard.height_m)})
    return by_echoes if found is None else found.joined(by_echoes)


def _echoes(refined: Map, sonar: Sonar | None, chosen: NDArray[np.bool_]) -> Echoes | None:
    """Return the echoes from the ``chosen`` (n,) poses."""
    poses = np.where(chosen[:, None, None], refined.over_floor_T_b, np.nan)
    return echoes_in_map(sonar, refined.observations.stamps_s, poses, refined.floor_z_m)


def obstacles_by_points(bundle: Bundle, metric: bool, config: MaskingConfig) -> ObstacleList:
    """Return what the floor points of a refined part show; nothing where none of them is raised.

    Lengths of a map that is not ``metric`` are multiples of the flying height, of which a share stands for
    gamma_3.
    """
    scale = bundle.optimum.transform.scale
    above_m = max(config.gamma_3_m if metric else RELATIVE_GAMMA, RELIEF_SIGMAS * bundle.noise.relief * scale)
    surface = _heights_of_points(bundle, scale)
    if surface is None:
        return ObstacleList(above_m, ())
    return standing_on(surface, above_m, {"pictures": np.isfinite(surface.height_m)})


def _heights_of_points(bundle: Bundle, scale: float) -> Elevation | None:
    """Return the heights that floor points show; None where none of them is raised."""
    optimum = bundle.optimum
    raised = optimum.problem.raised
    if raised is None or not raised.any():
        return None
    views = np.bincount(optimum.problem.tracks.track[optimum.used], minlength=len(raised))
    seen = views >= _LEAST_VIEWS
    place, height_m = metric_points(optimum)[seen, :2], scale * optimum.at.point[seen, 2]
    # A point stands for the ground as far as the others that count with it in a cell.
    nearest = min(NEAREST, len(place))
    apart = np.asarray(cKDTree(place).query(place, [nearest])[0])[:, 0]
    return elevation_map(place, height_m, np.minimum(apart, 2 * np.median(apart)), _CELLS_A_DISTANCE)
