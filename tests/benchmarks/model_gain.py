"""Gain of criticism in the map: an instrument has an error, the flight shows it, and the map is corrected.

The flight is the figure eight with one hidden effect; `slam.criticise` gets that one flight without its
truth.
"""

from __future__ import annotations

from dataclasses import replace

from slam.criticism import criticise
from slam.evaluation.map_gain import MapGain, map_gain
from slam.simulation import simulate
from slam.simulation.inverse import correct_flight
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_most, reported

HIDDEN: dict[str, tuple[dict[str, float], float]] = {
    "sonar_scale": ({"eps": 0.06}, 5.0),
    "focal_length": ({"eps": 0.03}, 5.0),
    "camera_tilt": ({"x": 0.04, "y": -0.03}, 5.0),
    "rolling_shutter": ({"readout": 0.03}, 15.0),
}
"""Term -> its size, and the picture rate in 1/s."""
SEED = 1


def measure() -> list[Metric]:
    """Return the errors before and after, for one effect at a time."""
    return [metric for term in HIDDEN for metric in of(term)]


def of(term: str) -> list[Metric]:
    """Return the figures of one hidden effect."""
    size, rate_hz = HIDDEN[term]
    eight = load_recipe("figure_eight")
    assert eight.camera is not None
    camera, model = replace(eight.camera, rate_hz=rate_hz), eight.model.with_term(term, **size)
    flight = simulate(replace(eight, camera=camera, model=model), SEED)
    verdict = criticise([replace(flight, truth=None)], eight.model)
    named = ", ".join(cause.name for cause in verdict.causes) or verdict.verdict
    mended = correct_flight(flight, verdict.extended).flight if verdict.extended else flight
    return figures(term, size, named, map_gain(flight, mended))


def figures(term: str, size: dict[str, float], named: str, gain: MapGain) -> list[Metric]:
    """Return the rows of one effect."""
    hidden = ", ".join(f"{name} {value:g}" for name, value in size.items())
    both = f"{1e3 * gain.after.position_m:.2f} over {1e3 * gain.before.position_m:.1f} mm"
    return [
        at_most(
            f"{term} ({hidden}): position error with the found causes corrected, over that as recorded",
            gain.after.position_m / gain.before.position_m, "x", 0.5, f"{both}; found: {named}",
        ),
        reported(
            f"{term}: mean NEES of poses then", gain.after.nees, "",
            f"6 expected; {gain.before.nees:.0f} as recorded",
        ),
    ]  # fmt: skip
