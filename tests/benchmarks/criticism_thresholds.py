"""Thresholds of criticism from simulated healthy flights.

``python -m tests.benchmarks.criticism_thresholds [CASES] [FIRST]`` prints for each case the greatest z of all
terms, of residual patterns and of pairs of terms as a line of JSON. With all cases done, it prints the
thresholds that one healthy case in a hundred exceeds. Every third case has Student's tails. For flights
without commands it prints the greatest z of the terms alone, and no threshold.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from slam.criticism.camera.reprojection import without_mismatched_pairs
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.prepare import usable_records
from slam.criticism.search.expansion import expand
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.criticism.without_commands.sensor_comparison import SensorComparison
from slam.simulation.camera.optics import CameraModel
from slam.simulation.healthy.flights import at_lower_rates, healthy_case
from slam.simulation.model import load_model

RATES = (0.007, 0.003, 0.001)
"""False-alarm rates of terms, residual patterns and pairs."""
CAMERA = CameraModel(rate_hz=5.0)


def greatest(seed: int, camera: CameraModel | None = None) -> tuple[float, str, float, str, float, str]:
    """Return the greatest z of terms, residual patterns and pairs of one healthy case, with their names."""
    slower = at_lower_rates(load_model("nominal"))
    records, _ = usable_records(healthy_case(slower, seed, student=seed % 3 == 2, camera=camera))
    nominal = filter_parameters_of(slower)
    records = [without_mismatched_pairs(referred(record, nominal), nominal)[0] for record in records]
    expansion = expand(records, nominal, fit_nuisances(records, nominal))
    terms = max(expansion.score_tests([], expansion.effects), key=lambda s: s.z)
    patterns = max(expansion.score_tests([], expansion.patterns), key=lambda s: s.z)
    pair = max(expansion.ranked_pairs([]), key=lambda p: p.z)
    both = " and ".join(e.label for e in pair.effects)
    return terms.z, terms.effect.label, patterns.z, patterns.effect.name, pair.z, both


def greatest_without_commands(seed: int, camera: CameraModel | None = None) -> tuple[float, str]:
    """Return the greatest z and its name where the instruments of one healthy case are compared with each
    other."""
    model = load_model("nominal")
    flights = healthy_case(model, seed, student=seed % 3 == 0, camera=camera)
    found = SensorComparison.of(flights, model)
    expansion = likelihood_of(found.rows({}), found.parameters).last
    most = max(expansion.score_tests([], expansion.effects), key=lambda s: s.z)
    return most.z, most.effect.name


def thresholds(*greatest: np.ndarray) -> tuple[float, ...]:
    """Return thresholds from the greatest values (n,) of each kind, as if each were the maximum of n
    Gaussians."""
    return tuple(_tail(values, rate) for values, rate in zip(greatest, RATES, strict=True))


def _tail(values: np.ndarray, rate: float) -> float:
    """Return the z exceeded at a rate: that of the maximum of n Gaussians, with n fitted to the median."""
    from scipy.optimize import brentq
    from scipy.stats import norm

    median = float(np.median(values))
    count = np.log(2.0) / (2.0 * norm.sf(median))
    return float(brentq(lambda z: 1.0 - np.exp(-count * 2.0 * norm.sf(z)) - rate, 1.0, 10.0))


def main(cases: int, first: int, camera: CameraModel | None = None) -> None:
    """Run the cases and print their values and the thresholds."""
    found = []
    for seed in range(first, first + cases):
        found.append(greatest(seed, camera))
        print(json.dumps([seed, *found[-1]]), flush=True)
    print(thresholds(*(np.array([f[k] for f in found]) for k in (0, 2, 4))))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.criticism_thresholds", description=__doc__
    )
    parser.add_argument("cases", nargs="?", type=int, default=60)
    parser.add_argument("first", nargs="?", type=int, default=0, help="seed of the first case")
    parser.add_argument("--pictures", action="store_true", help="flights with a camera")
    parser.add_argument("--without-commands", action="store_true", help="instruments against each other")
    options = parser.parse_args()
    camera = CAMERA if options.pictures else None
    if options.without_commands:
        for case in range(options.first, options.first + options.cases):
            print(json.dumps([case, *greatest_without_commands(case, camera)]), flush=True)
    else:
        main(options.cases, options.first, camera)
