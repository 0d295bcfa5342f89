"""Gross outliers among the GPS fixes: the map with them beside the map of the same fixes without them.

The pictures of each set are tracked and matched once. The graph is then solved for each share and size of
the outliers, the first fix always among them, and once more without these fixes. The GPS of caliterra errs
by 17 m, so that 20 m are no outlier there: its fixes are made from the structure-from-motion reference.
``python -m tests.benchmarks.gps_outliers SET...`` prints each case of some sets.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, geodetic_from_enu
from slam.core.progress import silent
from slam.core.stage_timer import Stopwatch
from slam.core.streams import Frames, Gps
from slam.evaluation.trajectory import umeyama
from slam.io.photos.import_photos import import_photos
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context, Job
from slam.mapping.map import Map
from slam.mapping.obstacles import no_masks
from slam.mapping.stages import close_loops, match_overlaps, odometry, refine, solve_again, track
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most
from tests.slam.small_flight import flown, gps_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHARES, SIZES_M = (0.01, 0.1, 0.3), (20.0, 1e3, 1e6)
SETS = ("caliterra", "isfm", "flight 0", "flight 1", "flight 2")
CALITERRA_PHOTOS, CALITERRA_STD_M, FLIGHT_STD_M = 40, 0.3, 0.1
LARGEST_RATIO = 1.1


@dataclass(frozen=True)
class Matched:
    """A flight whose pictures are matched."""

    flight: Flight
    context: Context
    map: Map
    fixes_m: Array
    """(n, 3) its fixes about ``origin``."""
    truth_m: Array
    """(k, 3) positions of the keyframes about ``origin``."""
    origin: GeoOrigin

    def solved(self, fixes_m: Array, used: Mask) -> tuple[Flight, Map, float]:
        """Return the flight with some fixes alone, its map, and the RMS position error [m], not aligned."""
        assert self.flight.gps is not None
        gps = _gps(self.flight.gps.stamps_s[used], fixes_m[used], self.origin, self.flight.gps.noise_std_m)
        flight = replace(self.flight, gps=gps)
        context = Context.of(flight, self.context.job, self.context.front_end, self.map.observations)
        found = refine(context, solve_again(context, self.map), with_inertia=True)
        off = self.errors_m(found, flight)
        return flight, found, float(np.sqrt(np.nanmean(np.sum(off**2, axis=1))))

    def errors_m(self, found: Map, flight: Flight) -> Array:
        """Return the errors (k, 3) of the keyframes' positions on a map of a flight, not aligned."""
        origin = flight.geo_origin()
        assert origin is not None
        truth_m = enu_from_geodetic(*geodetic_from_enu(self.truth_m, self.origin), origin)
        return found.w_T_b[:, :3, 3] - truth_m


@dataclass(frozen=True)
class Case:
    """One share and size of outliers."""

    share: float
    size_m: float
    outliers: int
    named: int
    false: int
    """Fixes that are named and right."""
    ratio: float
    """Position error over that without the outliers."""


def measure() -> list[Metric]:
    """Return the worst case of each set, and how many outliers are named."""
    metrics, skipped = [], []
    for name in SETS:
        try:
            cases = list(cases_of(name))
        except Skipped as reason:
            skipped.append(f"{name}: {reason}")
            continue
        worst = max(cases, key=lambda case: case.ratio)
        how = f"{100 * worst.share:g} % by {worst.size_m / 1e3:g} km, of {len(cases)} cases"
        outliers, named = sum(c.outliers for c in cases), sum(c.named for c in cases)
        metrics += [
            at_most(f"{name}: position error over that without", worst.ratio, "x", LARGEST_RATIO, how),
            at_least(f"{name}: outliers named, of {outliers}", named, "", outliers),
            at_most(f"{name}: right fixes that are named", sum(c.false for c in cases), "", 0),
        ]
    if not metrics:
        raise Skipped("; ".join(skipped))
    return metrics


def cases_of(name: str) -> Iterator[Case]:
    """Yield all cases of a set. Raises ``Skipped`` without its pictures."""
    made = matched(name)
    n = len(made.fixes_m)
    for number, (share, size_m) in enumerate(product(SHARES, SIZES_M)):
        rng = np.random.default_rng(number)
        bad = np.arange(n) == 0
        bad[1 + rng.choice(n - 1, max(1, int(share * n)) - 1, replace=False)] = True
        away = rng.normal(size=(n, 3)) * [1.0, 1.0, 0.3]
        away *= size_m / np.linalg.norm(away, axis=1, keepdims=True)
        flight, with_them, error_m = made.solved(made.fixes_m + bad[:, None] * away, np.ones(n, bool))
        *_, least_m = made.solved(made.fixes_m, ~bad)
        named = named_fixes(flight, with_them)
        yield Case(
            share=share,
            size_m=size_m,
            outliers=int(bad.sum()),
            named=int((named & bad).sum()),
            false=int((named & ~bad).sum()),
            ratio=error_m / least_m,
        )


def named_fixes(flight: Flight, found: Map) -> Mask:
    """Return the fixes (n,) that the flight's anomalies and the map's warnings name."""
    assert flight.gps is not None
    lines = map(str, (*describe(flight).anomalies, *found.remarks, *found.warnings))
    listed = ", ".join(line for line in lines if line.startswith("gps0") and " fixes " in line)
    words = listed.replace(":", ",").split(", ")
    named = {word.split(" (")[0].strip() for word in words}
    return np.array([name in named for name in flight.picture_names(flight.gps.stamps_s)])


def matched(name: str) -> Matched:
    """Track and match the pictures of a set once."""
    flight = _flight(name)
    assert flight.camera is not None
    job = Job(flight.camera, PipelineConfig(), silent, Stopwatch())
    context, observations = track(job, flight, no_masks)
    first = refine(context, close_loops(context, odometry(context, observations)))
    found = match_overlaps(context, first)
    origin = flight.geo_origin()
    assert flight.gps is not None
    assert origin is not None
    gps, keyframe = flight.gps, found.observations.frame_index
    fixes_m = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, gps.altitude_m, origin)
    if name == "caliterra":
        truth_m = _reference(flight, first)
        std = (CALITERRA_STD_M,) * 3
        fixes_m = truth_m + np.random.default_rng(0).normal(0, CALITERRA_STD_M, truth_m.shape)
        flight = replace(flight, gps=_gps(gps.stamps_s, fixes_m, origin, std))
        return Matched(flight, context, found, fixes_m, truth_m[keyframe], origin)
    if flight.truth is None:
        return Matched(flight, context, found, fixes_m, fixes_m[keyframe], origin)
    at_s, truth = found.observations.stamps_s, flight.truth
    flown_m = np.column_stack([np.interp(at_s, truth.stamps_s, truth.w_T_b[:, k, 3]) for k in range(3)])
    start_m = np.array([np.interp(gps.stamps_s[0], truth.stamps_s, truth.w_T_b[:, k, 3]) for k in range(3)])
    noiseless = gps_of(flight, 0.0)
    start = GeoOrigin(*(float(axis[0]) for axis in _axes(noiseless)))
    geodetic = geodetic_from_enu(flown_m - start_m, start)
    return Matched(flight, context, found, fixes_m, enu_from_geodetic(*geodetic, origin), origin)


def _flight(name: str) -> Flight:
    if name.startswith("flight "):
        flight = flown(int(name.split()[1]))
        return replace(flight, gps=gps_of(flight, FLIGHT_STD_M))
    flight = import_photos(folder(f"photos/{name}"))
    if name == "isfm":
        return flight
    frames, gps, n = flight.frames, flight.gps, CALITERRA_PHOTOS
    assert frames is not None
    assert gps is not None
    first = Frames(frames.stamps_s[:n], frames.names[:n], frames.load, frames.failures)
    return replace(flight, frames=first, gps=Gps(gps.stamps_s[:n], *(axis[:n] for axis in _axes(gps))))


def _reference(flight: Flight, found: Map) -> Array:
    """Return the reference's position of each photograph, put on our level map."""
    with (folder("photos/caliterra") / "sfm_reference.csv").open() as stream:
        rows = {row[0]: [float(x) for x in row[1:4]] for row in list(csv.reader(stream))[1:]}
    assert flight.frames is not None
    theirs = np.array([rows[name] for name in flight.frames.names])
    placed = found.component == 0
    keyframe = found.observations.frame_index[placed]
    return umeyama(theirs[keyframe], found.w_T_b[placed, :3, 3], with_scale=True).apply(theirs)


def _axes(gps: Gps) -> tuple[Array, Array, Array]:
    return gps.latitude_deg, gps.longitude_deg, gps.altitude_m


def _gps(stamps_s: Array, fixes_m: Array, origin: GeoOrigin, std_m: tuple[float, float, float]) -> Gps:
    return Gps(stamps_s, *geodetic_from_enu(fixes_m, origin), std_m)


if __name__ == "__main__":
    for chosen in sys.argv[1:] or SETS:
        for case in cases_of(chosen):
            print(chosen, case, flush=True)
