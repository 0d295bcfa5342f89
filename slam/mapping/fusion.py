"""All connected parts of a flight: placed in the world, refined on their floor points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle.refinement import Bundle
from backend.errors import BackendError
from backend.inertial_scale.preintegration import InertialReadings
from backend.inertial_scale.scale import NoScale
from backend.measurements import FloorTracks, Position, RelativePose
from backend.pose_graph.solution import Solution
from frontend.camera import Camera
from frontend.registration import Registration
from slam.core.estimate import over_floor
from slam.core.heap import trim_heap
from slam.core.progress import Progress
from slam.mapping.lengths import InertialLengths, inertial_lengths
from slam.mapping.mapper import LEAST_SEEN, Edges, Mapper, Sensors
from slam.mapping.placement import lay_onto
from slam.mapping.sightings import Sightings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fused:
    """All connected parts, refined and placed."""

    w_T_b: Array
    covariances: Array
    over_floor_covariances: Array
    """Both as `slam.core.estimate.Estimate` has them."""
    component: NDArray[np.int64]
    floor_z_m: float
    camera: Camera
    bundle: Bundle | None
    """Of the largest part."""
    georeferenced: bool
    warnings: tuple[str, ...]
    height_std_m: tuple[float, ...]
    """Of each part's first keyframe over the floor, beside what all parts err by together; 0 where not
    known. In the part's own covariances that height is certain."""
    inertial: InertialLengths | None = None
    """What the accelerometer tells of the largest part."""
    metric: bool = True
    """Whether lengths of the largest part are metres; else they are in mean heights of the camera."""
    bridges: tuple[RelativePose, ...] = ()
    """Edges of kind ``inertial`` along which parts were laid together (`slam.mapping.bridging`)."""

    @property
    def slope_rad(self) -> tuple[float, float]:
        """Of the ground, as `slam.core.estimate.Estimate` has it."""
        return self.bundle.floor_slope_rad if self.bundle else (0.0, 0.0)

    def of_main(self, poses: Array) -> Array:
        """Poses (n, 4, 4) of the largest part, NaN for the others, which have worlds of their own."""
        return np.where((self.component == 0)[:, None, None], poses, np.nan)

    @property
    def over_floor_T_b(self) -> Array:
        """(n, 4, 4) poses over a floor made level at ``floor_z_m``."""
        return over_floor(self.w_T_b, self.slope_rad, self.floor_z_m)


def fuse(
    mapper: Mapper,
    sightings: Sightings,
    edges: Edges,
    solution: Solution,
    progress: Progress,
    readings: InertialReadings | None = None,
) -> Fused:
    """Place each connected part and refine it on its floor points; with ``readings`` on its inertia too."""
    n = len(mapper.sensors.stamps_s)
    kept = [r for r, ok in zip(edges.registrations, solution.edge_kept, strict=True) if ok]
    tracks = mapper.tracks(sightings.store.points, kept)
    trim_heap()
    component = largest_first(np.where(_tied(n, kept), solution.component, -1))
    evidence = _Evidence(mapper, sightings, edges.heights.metric, tracks, readings, progress)
    seen = np.bincount(tracks.keyframe, minlength=n)
    parts = []
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        if (seen[members] >= LEAST_SEEN).sum() >= 2:
            # A picture that sees next to no point of the others' must not keep them from being refined.
            component[members[seen[members] < LEAST_SEEN]] = -1
            members = np.flatnonzero(component == number)
        parts.append(evidence.part(members, solution.w_T_b[members]))
    w_T_b, (covariances, over_floor_covariances) = np.full((n, 4, 4), np.nan), np.full((2, n, 6, 6), np.nan)
    for part in parts:
        w_T_b[part.members] = part.w_T_b
        if part.bundle is not None:
            covariances[part.members] = part.bundle.covariances
            over_floor_covariances[part.members] = part.bundle.over_floor_covariances
    main = parts[0] if parts else None
    return Fused(
        w_T_b,
        covariances,
        over_floor_covariances,
        component,
        floor_z_m=main.floor_z_m if main else 0.0,
        camera=_calibrated(mapper.camera, main.bundle) if main and main.bundle else mapper.camera,
        bundle=main.bundle if main else None,
        georeferenced=main.georeferenced if main else False,
        warnings=tuple(line for part in parts for line in part.warnings),
        height_std_m=tuple(part.height_std_m for part in parts),
        inertial=main.inertial if main else None,
        metric=main.metric if main else True,
    )


@dataclass(frozen=True)
class Part:
    """One connected part of the map."""

    members: NDArray[np.int64]
    """(m,) its keyframes, sorted."""
    w_T_b: Array
    """(m, 4, 4) refined; placed at least."""
    floor_z_m: float
    georeferenced: bool
    """Whether positions have placed it; else it stands in coordinates of its own."""
    ranged: bool
    """Whether its heights were measured in metres."""
    bundle: Bundle | None = None
    """None where it could not be refined."""
    inertial: InertialLengths | None = None
    warnings: tuple[str, ...] = ()

    @property
    def metric(self) -> bool:
        """Whether its lengths are metres."""
        refined = self.bundle is not None and self.bundle.scale_std is not None
        return self.ranged or self.georeferenced or refined

    @property
    def height_std_m(self) -> float:
        """As `Fused` has it."""
        if self.bundle is None:
            return 0.0
        return self.bundle.conditional_scale_std * float(self.bundle.w_T_b[0, 2, 3] - self.bundle.floor_z_m)


@dataclass(frozen=True)
class _Evidence:
    """What parts are placed and refined by."""

    mapper: Mapper
    sightings: Sightings
    metric: NDArray[np.bool_]
    """(n,) which keyframes have a height in metres."""
    tracks: FloorTracks
    readings: InertialReadings | None
    progress: Progress

    def part(self, members: NDArray[np.int64], w_T_b: Array) -> Part:
        """Keyframes ``members`` (m,), placed and refined from the pose graph's ``w_T_b`` (m, 4, 4)."""
        sensors, warnings = self.mapper.sensors, []
        ranged = bool(self.metric[members].all())
        laid = lay_onto(w_T_b, _renumbered(self.mapper, members), ranged)
        start, floor_z_m = laid if laid is not None else (_headed(w_T_b, sensors, members), 0.0)
        if laid is None and sensors.positions:
            warnings.append(
                f"{len(members)} keyframes have no usable GPS position: they are in coordinates of their "
                "own, not on Earth"
            )
        # Positions that could not place the part are not to pull at it either.
        usable = self.mapper if laid is not None else self.mapper.without_positions()
        placed = Part(members, start, floor_z_m, laid is not None, ranged)
        try:
            bundle, by_inertia = self._refined(usable, placed)
        except BackendError as error:
            warnings.append(
                f"the part of the map with {len(members)} keyframes could not be refined: {error}"
            )
            return replace(placed, warnings=tuple(warnings))
        warnings += _told(by_inertia, bundle)
        return replace(
            placed,
            w_T_b=bundle.w_T_b,
            floor_z_m=bundle.floor_z_m,
            bundle=bundle,
            inertial=by_inertia if isinstance(by_inertia, InertialLengths) else None,
            warnings=tuple(warnings),
        )

    def _refined(self, mapper: Mapper, part: Part) -> tuple[Bundle, InertialLengths | NoScale | None]:
        """The part refined, and what the accelerometer tells of it: used where ranges and positions tell
        less."""

        def step(iteration: int, _: float) -> None:
            self.progress("refine", iteration, 0)

        members, tracks = part.members, self.tracks
        start = np.full((len(self.metric), 4, 4), np.nan)
        start[members] = part.w_T_b
        bundle = mapper.refine(members, start, part.floor_z_m, tracks, step)
        if self.readings is None:
            return bundle, None
        camera, gain_std = _calibrated(mapper.camera, bundle), mapper.config.trust.accel_gain_std
        by_inertia = inertial_lengths(self.readings, self.sightings, members, bundle, camera, gain_std)
        if isinstance(by_inertia, NoScale) or not by_inertia.helps:
            return bundle, by_inertia
        start[members] = bundle.w_T_b
        lengths, noise = by_inertia.lengths, bundle.noise
        return mapper.refine(members, start, bundle.floor_z_m, tracks, step, lengths, noise), by_inertia


def _told(by_inertia: InertialLengths | NoScale | None, bundle: Bundle) -> list[str]:
    """What a person must know of it: where it contradicts, and where it was wanted for lengths in vain."""
    if isinstance(by_inertia, NoScale):
        wanted = bundle.scale_std is None
        return [f"imu0 could not determine the metric scale: {by_inertia.reason}"] if wanted else []
    return [by_inertia.contradiction] if by_inertia is not None and by_inertia.contradiction else []


def _tied(n: int, kept: Sequence[Registration]) -> NDArray[np.bool_]:
    tied = np.zeros(n, bool)
    for r in kept:
        tied[[r.i, r.j]] = True
    return tied


def largest_first(component: NDArray[np.int64]) -> NDArray[np.int64]:
    """Parts renumbered without gaps, 0 the largest; -1 stays."""
    label, size = np.unique(component[component >= 0], return_counts=True)
    out = np.full_like(component, -1)
    for number, k in enumerate(np.lexsort((label, -size))):
        out[component == label[k]] = number
    return out


def _renumbered(mapper: Mapper, members: NDArray[np.int64]) -> list[Position]:
    number = {int(k): m for m, k in enumerate(members)}
    return [replace(p, k=number[p.k]) for p in mapper.sensors.positions if p.k in number]


def comparable(w_T_b: Array, mapper: Mapper, fused: Fused) -> Array:
    """Poses of a lesser method where the result stands, so that the two can be compared."""
    if fused.georeferenced:
        laid = lay_onto(w_T_b, mapper.sensors.positions, metric=False)
        return np.full_like(w_T_b, np.nan) if laid is None else laid[0] + _lift(fused.floor_z_m - laid[1])
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    comparable = w_T_b.copy()
    if len(placed):
        comparable[placed] = _headed(w_T_b[placed], mapper.sensors, placed)
    return comparable


def _lift(z_m: float) -> Array:
    shift = np.zeros((4, 4))
    shift[2, 3] = z_m
    return shift


def _headed(w_T_b: Array, sensors: Sensors, members: NDArray[np.int64]) -> Array:
    """The first keyframe above the origin, its heading as its own attitude has it."""
    yaw = next((a.roll_pitch_yaw_rad[2] for a in sensors.attitudes if a.k == members[0]), 0.0)
    now = np.arctan2(w_T_b[0, 1, 0], w_T_b[0, 0, 0])
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw - now).as_matrix()
    shift = np.eye(4)
    shift[:2, 3] = -w_T_b[0, :2, 3]
    return turn @ shift @ w_T_b


def _calibrated(camera: Camera, bundle: Bundle) -> Camera:
    camera = replace(camera, b_T_c=bundle.b_T_c)
    if camera.focal_std_ratio == 0:
        return camera
    return replace(camera, focal_px=bundle.focal_px, distortion=(*bundle.radial, 0.0, 0.0))
