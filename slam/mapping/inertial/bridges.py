"""Inertial edges across gaps in the chain of pictures, so that all parts of the map share one world frame.

The filter uses the steps between linked keyframes as readings, so it estimates the velocity and the sensor
offsets at both ends of a segment without features. It keeps the pose of each keyframe until the next one. The
relative pose across the segment then has the joint covariance of both ends, not the sum of two nearly equal
errors.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.ekf.inputs import VisualStep, renumber_steps
from backend.errors import BackendError
from backend.measurements import RelativePose
from backend.pose_graph.heights import HeightEstimate
from backend.preintegration.limits import MOST_HEIGHTS, MOST_SIGMAS
from backend.quantiles import chi_square_quantile
from frontend.lift import lift
from frontend.registration import Registration
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import Progress, show_compilation, silent
from slam.inertial.instruments import InertialTrust
from slam.mapping.inertial.bridge import Bridge
from slam.mapping.inertial.metres import in_metres
from slam.mapping.map import Map, largest_first
from slam.mapping.setup import Setup

if TYPE_CHECKING:
    from backend.ekf.results import States

Array = NDArray[np.float64]

_LEVEL = np.array([2, 3, 4])
"""Rows of a pose's error in which a part of a map is free: heading, x, y. Its floor is level and at z = 0."""
_MOST_HEIGHT_STD = 0.3
"""Largest relative deviation of a height by the accelerometer that is worth a check: beyond it lengths may be
wrong by two times."""
_HEIGHT = 5
"""Row of the height, which each part fixes by its floor and which has an error all the same."""


def picture_steps(links: Sequence[Registration | None], setup: Setup) -> tuple[VisualStep, ...]:
    """Return the steps between successive keyframes with linked pictures, in heights of the first."""
    linked = [link for link in links if link is not None and link.j == link.i + 1]
    i = np.array([link.i for link in linked], dtype=np.int64)
    lifted = lift(
        np.array([link.i_H_j for link in linked]).reshape(-1, 3, 3),
        np.array([link.corner_covariance for link in linked]).reshape(-1, 8, 8),
        setup.camera,
        setup.readings.roll_pitch_rad[i],
        setup.readings.roll_pitch_std_rad[i],
    )
    return tuple(
        VisualStep(linked[m].i, linked[m].j, lifted.i_T_j[m], lifted.covariance[m])
        for m in np.flatnonzero(lifted.usable).tolist()
    )


@dataclass(frozen=True)
class FilteredGaps:
    """The filter's answer on the gaps in the chain of pictures."""

    edges: tuple[RelativePose, ...] = ()
    """One of kind ``inertial`` for each pair of successive keyframes that no picture step joins."""
    heights: HeightEstimate | None = None
    """Heights of the keyframes by the accelerometer, NaN outside the readings; None where ranges tell them,
    or nothing does."""


def filtered_gaps(
    flight: Flight,
    stamps_s: Array,
    steps: tuple[VisualStep, ...],
    trust: InertialTrust = InertialTrust(),
    progress: Progress = silent,
) -> FilteredGaps:
    """Return the relative poses across gaps, and the heights, by the filter.

    Edges that are too uncertain are left out. There are none where neither ranges nor the accelerometer tell
    the heights. Raises ``InputError`` where too little was recorded, and ``BackendError`` where the filter
    fails.
    """
    from slam.inertial.motion import filter_motion
    from slam.inertial.noise_identification import identify_noise

    inputs = identify_noise(flight, trust, progress, stamps_s, steps)
    inside = (stamps_s >= inputs.start_s) & (stamps_s <= inputs.end_s)
    by_accelerometer = inputs.adjustments.start is not None
    if (inputs.readings.range_m is None and not by_accelerometer) or inside.sum() < 2:
        return FilteredGaps()
    reached = {step.j for step in steps}
    steps = renumber_steps(steps, inside)
    found = filter_motion(inputs, stamps_s[inside], steps=steps, keep="each", progress=progress)
    states, numbers = found.smoothed, np.flatnonzero(inside)
    assert states is not None
    heights = None
    if by_accelerometer:
        heights = heights_by_accelerometer(states, steps, inputs.model.b_p_camera_m)
        if heights is None:
            return FilteredGaps()
        heights = _of_all(heights, inside)
    edges = []
    for k in range(1, len(numbers)):
        i, j = int(numbers[k - 1]), int(numbers[k])
        covariance = states.clone_T_b_covariances[k]
        height_m = max(float(states.w_T_b[k - 1, 2, 3]), 0.0)
        if j not in reached and np.trace(covariance[3:, 3:]) < (MOST_HEIGHTS * height_m) ** 2:
            edges.append(RelativePose(i, j, states.clone_T_b[k], covariance, "inertial"))
    return FilteredGaps(tuple(edges), heights)


def heights_by_accelerometer(
    states: States, steps: tuple[VisualStep, ...], b_p_c_m: tuple[float, float, float]
) -> HeightEstimate | None:
    """Return the heights of smoothed ``states``, one a picture; None where they are not known.

    They are not where they are too uncertain, and where the path does not show what the ``steps`` of the
    camera at ``b_p_c_m`` do: from a start too far off the smoother may settle elsewhere.
    """
    height_m = states.w_T_b[:, 2, 3]
    b_T_c = np.eye(4)[None].copy()
    b_T_c[0, :3, 3] = b_p_c_m
    camera_m = (states.w_T_b @ b_T_c)[:, 2, 3]
    if not (np.minimum(height_m, camera_m) > 0).all():
        return None
    log_std = np.sqrt(states.motion_covariances[:, 2, 2]) / height_m
    if not (log_std < _MOST_HEIGHT_STD).all():
        return None
    moved = se3.inverse(b_T_c) @ states.clone_T_b[[step.j for step in steps]] @ b_T_c
    moved[:, :3, 3] /= camera_m[[step.i for step in steps], None]
    off = se3.log(se3.inverse(moved) @ np.array([step.i_T_j for step in steps]))
    squares = [float(x @ np.linalg.solve(s.covariance, x)) for x, s in zip(off, steps, strict=True)]
    shown = np.median(squares) < MOST_SIGMAS**2 * chi_square_quantile(0.5, 6)
    return HeightEstimate(height_m, log_std, np.ones(len(height_m), dtype=bool)) if shown else None


def _of_all(heights: HeightEstimate, inside: NDArray[np.bool_]) -> HeightEstimate:
    """Return the heights of all keyframes, NaN for those that are not ``inside`` (n,) the readings."""
    height_m, log_std = np.full((2, len(inside)), np.nan)
    height_m[inside], log_std[inside] = heights.height_m, heights.log_std
    return HeightEstimate(height_m, log_std, inside)


class InertialBridges:
    """Inertial edges across the breaks in one flight's chain of keyframes, computed when a map first needs
    them."""

    def __init__(
        self,
        flight: Flight,
        setup: Setup,
        links: Sequence[Registration | None],
        trust: InertialTrust = InertialTrust(),
        progress: Progress = silent,
    ) -> None:
        self.flight, self.setup, self.links = flight, setup, links
        self.trust, self.progress = trust, progress
        self._gaps: FilteredGaps | None = None

    def join(self, map_: Map) -> Map:
        """Return the map with its parts in one world frame where bridges exist; an unbroken map is returned
        unchanged.

        Each part keeps its shape. A bridge from an earlier part determines its heading and position, and its
        covariance is added to that of the part. A part knows its poses against its first keyframe alone. If
        the bridge ends at another one, that one's error counts at both ends, so that the sum is too large
        where the errors of both grow along the flight; the refinement of the whole replaces it.
        """
        if map_.component.max(initial=-1) < 1 or map_.georeferenced:
            return map_
        return joined(map_, self.edges())

    def without(self, pairs: Collection[tuple[int, int]]) -> InertialBridges:
        """Return the bridges of the chain without the links of some pairs."""
        kept = [link for link in self.links if link is not None and (link.i, link.j) not in pairs]
        return InertialBridges(self.flight, self.setup, kept, self.trust, self.progress)

    def edges(self) -> tuple[RelativePose, ...]:
        """Return one edge in metres for each break of a chain in metres; none if the instruments determine it
        too poorly."""
        gaps = self.gaps()
        return gaps.edges if gaps.heights is None else ()

    def gaps(self) -> FilteredGaps:
        """Return the edges across all breaks, with the heights that make a chain without ranges metric."""
        if self._gaps is None:
            steps = picture_steps(self.links, self.setup)
            try:
                stamps_s = self.setup.readings.stamps_s
                with show_compilation(self.progress):
                    self._gaps = filtered_gaps(self.flight, stamps_s, steps, self.trust, self.progress)
            except (InputError, BackendError):
                # The map stays in parts, and its status says so.
                self._gaps = FilteredGaps()
        return self._gaps

    def join_for_checks(self, chain: Map) -> Map:
        """Return the parts of a chain in one world frame in metres, so that loops between them are checked.

        Without ranges the heights by the accelerometer scale each part first.
        """
        if chain.component.max(initial=-1) < 1:
            return chain
        gaps = self.gaps()
        if not gaps.edges:
            return chain
        if gaps.heights is not None:
            chain = in_metres(chain, gaps.heights, self.setup.config.trust.accel_gain_std)
        return joined(chain, gaps.edges)


@dataclass(frozen=True)
class _PartPose:
    """Pose of a part in the world frame of the part that it is joined to, with its covariance."""

    root_T_part: Array
    covariance: Array
    """(6, 6), rotation first, right perturbation; zero except for heading and position."""

    def with_height_std(self, std_m: float) -> _PartPose:
        """Return the pose with another standard deviation of the height: parts share one floor, so it does
        not grow with the length of the bridge."""
        covariance = self.covariance.copy()
        covariance[_HEIGHT, _HEIGHT] = std_m**2
        return _PartPose(self.root_T_part, covariance)


def joined(map_: Map, edges: Sequence[RelativePose]) -> Map:
    """Join the parts of a map by a minimum spanning forest of the edges; parts without an edge stay as they
    are."""
    import networkx as nx  # its import takes longer than most joins, and few maps have parts

    parts = nx.Graph()
    parts.add_nodes_from(range(int(map_.component.max(initial=-1)) + 1))
    for edge in edges:
        a, b = int(map_.component[edge.i]), int(map_.component[edge.j])
        if a < 0 or b < 0 or a == b:
            continue
        weight = float(np.trace(edge.covariance[3:, 3:]))
        if not parts.has_edge(a, b) or weight < parts[a][b]["weight"]:
            parts.add_edge(a, b, weight=weight, edge=edge)
    forest = nx.minimum_spanning_tree(parts)
    w_T_b, covariances = map_.w_T_b.copy(), map_.covariances.copy()
    over_floor_covariances = map_.over_floor_covariances.copy()
    component, used = map_.component.copy(), []
    first = {part: int(np.argmax(component == part)) for part in parts}
    # The part of the first keyframe defines the world frame of the map, however small it is.
    for root in [min(nodes, key=first.__getitem__) for nodes in nx.connected_components(forest)]:
        poses = {root: _PartPose(np.eye(4), np.zeros((6, 6)))}
        for parent, part in nx.bfs_edges(forest, root):
            edge = forest[parent][part]["edge"]
            poses[part] = _composed(poses[parent], _part_transform(map_, edge, part)).with_height_std(
                float(np.hypot(map_.height_std_m[root], map_.height_std_m[part]))
            )
            used.append(edge)
            members = map_.component == part
            w_T_b[members] = poses[part].root_T_part @ map_.w_T_b[members]
            carry = se3.adjoint(se3.inverse(map_.w_T_b[members]))
            covariances[members] += carry @ poses[part].covariance @ carry.transpose(0, 2, 1)
            # The height over the floor is in the covariances of the part itself.
            in_plane = poses[part].with_height_std(0.0).covariance
            over_floor_covariances[members] += carry @ in_plane @ carry.transpose(0, 2, 1)
            component[members] = root
    if not used:
        return map_
    return replace(
        map_,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        component=largest_first(component),
        bridges=tuple(map(Bridge, used)),
    )


def _part_transform(map_: Map, edge: RelativePose, part: int) -> _PartPose:
    """Return the planar pose of ``part`` in the world frame of the other part, along an edge between them."""
    i, j, i_T_j, covariance = edge.i, edge.j, edge.i_T_j, edge.covariance
    if map_.component[i] == part:
        i, j = j, i
        turn = se3.adjoint(i_T_j[None])[0]
        i_T_j, covariance = se3.inverse(i_T_j[None])[0], turn @ covariance @ turn.T
    back = se3.adjoint(se3.inverse(i_T_j[None]))[0]
    # The covariances of a part are NaN where they are unknown, and so is the sum.
    own = [map_.covariances[k] for k in (i, j)]
    total = covariance + own[1] + back @ own[0] @ back.T
    carry = se3.adjoint(map_.w_T_b[j][None])[0]
    total = carry @ total @ carry.T
    flat = se3.from_planar(se3.to_planar((map_.w_T_b[i] @ i_T_j @ se3.inverse(map_.w_T_b[j][None])[0])[None]))
    level = np.zeros((6, 6))
    level[np.ix_(_LEVEL, _LEVEL)] = total[np.ix_(_LEVEL, _LEVEL)]
    return _PartPose(flat[0], level)


def _composed(parent: _PartPose, child: _PartPose) -> _PartPose:
    """Return the pose of ``child``, which is relative to ``parent``, in the world frame of the root."""
    back = se3.adjoint(se3.inverse(child.root_T_part[None]))[0]
    covariance = back @ parent.covariance @ back.T + child.covariance
    return _PartPose(parent.root_T_part @ child.root_T_part, covariance)
