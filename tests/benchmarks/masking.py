"""The gym: map errors with and without obstacle masking, and the shares of pixels and echoes.

The rate is eight pictures a second instead of the recipe's fifteen. Boxes of 0.12 to 0.35 m are under the
path, and pylons beside it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.config import MaskingConfig, PipelineConfig
from slam.mapping.obstacles import echoes_in_map, find_obstacles
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_most, reported

Array = NDArray[np.float64]

HEIGHTS_M = (0.8, 1.5, 0.5)
ON, OFF = MaskingConfig(), MaskingConfig(pixels=False, echoes=False)
PARTS = {"pixels only": MaskingConfig(echoes=False), "echoes only": MaskingConfig(pixels=False)}


@dataclass(frozen=True)
class Errors:
    """Position errors (RMS) with the first keyframe's position and yaw on the truth's, in metres."""

    map_m: float
    stamps_s: Array
    chain_off_m: Array
    """(n,) errors of the keyframes on the plain chain; NaN behind a break."""

    @property
    def unbroken_s(self) -> float:
        """Time in seconds for which the chain is unbroken."""
        return float(self.stamps_s[np.isfinite(self.chain_off_m)][-1])

    def chain_m(self, until_s: float = np.inf) -> float:
        """Return the error of the plain chain until some time."""
        known = np.isfinite(self.chain_off_m) & (self.stamps_s <= until_s)
        return float(np.sqrt(np.mean(self.chain_off_m[known] ** 2)))


def measure() -> list[Metric]:
    """Return the figures of three heights with seed 0, of the parts at 0.8 m, and of the cost on a flat
    floor."""
    metrics: list[Metric] = []
    for height_m in HEIGHTS_M:
        flight = gym(height_m)
        on, off = errors(flight, ON), errors(flight, OFF)
        at = f"at {height_m:g} m"
        metrics += [
            reported(f"{at}: map error without masking", off.map_m, "m"),
            reported(f"{at}: map error with masking", on.map_m, "m"),
            reported(
                f"{at}: chain of homographies without masking",
                off.chain_m(),
                "m",
                f"unbroken for {off.unbroken_s:.0f} s",
            ),
            reported(
                f"{at}: the same while the one with masking is unbroken", off.chain_m(on.unbroken_s), "m"
            ),
            reported(
                f"{at}: chain of homographies with masking",
                on.chain_m(),
                "m",
                f"unbroken for {on.unbroken_s:.0f} s",
            ),
        ]
        if height_m == 0.8:
            metrics.append(
                at_most(f"{at}: map error with masking over without", on.map_m / off.map_m, "x", 0.5)
            )
            for name, config in PARTS.items():
                part = errors(flight, config)
                metrics.append(reported(f"{at}: map error with {name}", part.map_m, "m"))
    return [*metrics, *price()]


def gym(height_m: float, flat: bool = False) -> Flight:
    """Return the recipe at another height."""
    recipe = load_recipe("gym")
    assert recipe.camera is not None
    world = replace(recipe.world, boxes=(), pylons=()) if flat else recipe.world
    maneuver = replace(recipe.maneuver, height_m=height_m)
    return simulate(
        replace(recipe, world=world, maneuver=maneuver, camera=replace(recipe.camera, rate_hz=8.0)), 0
    )


def errors(flight: Flight, masking: MaskingConfig) -> Errors:
    """Map the flight and compare with the truth."""
    found = evaluate(optimize(flight, PipelineConfig(masking=masking)), flight)
    chain_off_m = np.linalg.norm(found.tracks.chain_m - found.tracks.reference_m, axis=1)
    return Errors(found.ate_m.rmse, found.tracks.stamps_s, chain_off_m)


def price() -> list[Metric]:
    """Return the cost of the search for obstacles where there are none."""
    flight = gym(0.8, flat=True)
    assert flight.camera is not None
    began = time.perf_counter()
    estimate = optimize(flight, PipelineConfig(masking=OFF))
    whole = time.perf_counter() - began
    began = time.perf_counter()
    found = find_obstacles(
        flight, flight.camera, estimate.stamps_s, estimate.over_floor_T_b, estimate.floor_z_m, MaskingConfig()
    )
    echoes = echoes_in_map(flight.sonar, estimate.stamps_s, estimate.over_floor_T_b, estimate.floor_z_m)
    assert echoes is not None
    assert echoes.map is not None
    assert found is None, "a flat floor has no obstacles"
    share = (time.perf_counter() - began) / whole
    return [
        at_most("on a flat floor: time for obstacles and elevation over the whole job's", share, "x", 0.03)
    ]
