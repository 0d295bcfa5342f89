"""Camera, IMU and sonar together, compared with each pair of them and with the camera alone, over kinds of
simulated flights (`tests.benchmarks.instrument_flights`).

``python -m tests.benchmarks.instruments`` runs some of them: ``--kinds "gap of 2 s" violent --seeds 0 1``. It
prints one line of JSON for each flight, and then the figures.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import repeat
from multiprocessing import get_context

import numpy as np
from rich.console import Console

from tests.benchmarks.calibration import judged
from tests.benchmarks.instrument_flights import KINDS, SEEDS, flown
from tests.benchmarks.instrument_maps import (
    ALL,
    NO_CAMERA,
    NO_IMU,
    NO_SONAR,
    PAIRS,
    PARTS,
    Flown,
    Mapped,
    maps_of,
)
from tests.benchmarks.metric import Metric, at_least, at_most, reported

CORES = 2
GAP_SEEDS = range(10)
"""Seeds of the flights over a gap. Each tells one position behind it, so two flights would tell little; all
but those of ``SEEDS`` are mapped with all instruments alone."""
LESS = {"IMU": NO_IMU, "sonar": NO_SONAR, "camera": NO_CAMERA}
"""Instrument -> the set without it."""
WORSE = 1.1
"""Ratio of errors from which an instrument counts as missed."""


def measure() -> list[Metric]:
    """Return the figures over all kinds."""
    crossed = [kind.name for kind in KINDS.values() if kind.gap_s]
    more = [seed for seed in GAP_SEEDS if seed not in SEEDS]
    return figures(fly_all(list(KINDS), SEEDS), fly_all(crossed, more, sets=(ALL,)))


def fly_all(
    kinds: Sequence[str], seeds: Sequence[int], cores: int = CORES, sets: Sequence[str] = tuple(PARTS)
) -> list[Flown]:
    """Simulate and map flights; nothing is timed, so that flights may share the cores."""
    kind, seed = zip(*[(kind, seed) for kind in kinds for seed in seeds], strict=True)
    if cores == 1:
        return list(map(fly, kind, seed, repeat(sets)))
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        return list(pool.map(fly, kind, seed, repeat(sets)))


def fly(kind: str, seed: int, sets: Sequence[str] = tuple(PARTS)) -> Flown:
    """Simulate one flight and map it with some sets of its instruments."""
    return maps_of(flown(KINDS[kind], seed), kind, seed, KINDS[kind].gap_s, sets)


def figures(flights: Sequence[Flown], more: Sequence[Flown] = ()) -> list[Metric]:
    """Return the figures of some flights: together, then kind by kind; ``more`` flights over gaps count for
    the positions behind these."""
    kinds = list(dict.fromkeys(flight.kind for flight in flights))
    by_kind = {kind: [flight for flight in flights if flight.kind == kind] for kind in kinds}
    metrics = [*_together(flights, by_kind), *_consistency(flights)]
    for kind, found in by_kind.items():
        metrics += _of_kind(kind, found)
        if KINDS[kind].gap_s:
            metrics += _of_gaps(kind, [*found, *(flight for flight in more if flight.kind == kind)])
    return metrics


def _together(flights: Sequence[Flown], by_kind: dict[str, list[Flown]]) -> list[Metric]:
    ratio = {name: 1 / _without(flights, name) for name in PAIRS}
    known = {name: value for name, value in ratio.items() if np.isfinite(value)}
    best = max(known, key=lambda name: known[name], default=PAIRS[0])
    each = ", ".join(f"{value:.3g} x over {name}" for name, value in known.items())
    whole = sum(_all(flight).placed == 1.0 for flight in flights)
    silent = [f"{f.kind} {f.seed}" for f in flights if _all(f).status == "ok" and not _all(f).in_band]
    metrics = [
        at_most(
            f"position error with all instruments over the best two of them, RMS of {len(flights)} flights",
            ratio[best], "x", 0.8, each,
        ),
        at_least(f"flights of {len(flights)} whose keyframes are all in one map", whole, "", len(flights)),
        reported(
            "flights whose status is ok and whose mean NEES is outside its band", len(silent), "",
            ", ".join(silent),
        ),
    ]  # fmt: skip
    for instrument, less in LESS.items():
        worse = {kind: _without(found, less) for kind, found in by_kind.items()}
        known = {kind: value for kind, value in worse.items() if np.isfinite(value)}
        if known:
            kind = max(known, key=lambda kind: known[kind])
            what = f"position error without {instrument} over that with all, kind where it is largest"
            metrics.append(at_least(what, known[kind], "x", WORSE, f"{kind}; {_listed(known)}"))
    return metrics


def _consistency(flights: Sequence[Flown]) -> list[Metric]:
    metrics = []
    for name in (ALL, NO_SONAR, NO_IMU):
        maps = [flight.maps[name] for flight in flights if name in flight.maps]
        farthest = np.array([m.farthest for m in maps if np.isfinite(m.farthest)])
        scale = np.array([(m.log_scale / m.scale_std) ** 2 for m in maps if np.isfinite(m.scale_std)])
        metrics += judged(f"{name}, farthest keyframe", farthest, 6) if len(farthest) else []
        metrics += judged(f"{name}, scale", scale, 1) if len(scale) else []
        share = 100 * float(np.mean([m.in_band for m in maps])) if maps else np.nan
        metrics.append(reported(f"{name}: flights whose mean NEES is inside its band", share, "%"))
    return metrics


def _of_kind(kind: str, found: list[Flown]) -> list[Metric]:
    error = {
        name: _rms([flight.maps[name].error_m for flight in found if name in flight.maps]) for name in PARTS
    }
    maps = [_all(flight) for flight in found]
    others = [
        f"{name} {1e3 * error[name]:.3g} mm" for name in PARTS if name != ALL and np.isfinite(error[name])
    ]
    others.append(f"landmark distances {_rms([m.landmark_percent for m in maps]):.3g} %")
    others.append(f"mean NEES in band on {sum(m.in_band for m in maps)} of {len(maps)}")
    others.append(f"status ok on {sum(m.status == 'ok' for m in maps)}")
    metrics = [
        reported(
            f"{kind}: position error with all instruments", _rms([m.error_m for m in maps]), "m",
            "; ".join(others),
        )
    ]  # fmt: skip
    if kind == "floor of lines":
        least = 100 * _rms([flight.least_mean_error for flight in found])
        percent, shape = (
            _rms([100 * error_m / m.path_m for m, error_m in zip(maps, errors_m, strict=True)])
            for errors_m in ([m.mean_error_m for m in maps], [m.shape_error_m for m in maps])
        )
        metrics.append(
            at_most(
                f"{kind}: mean error of the path", percent, "%", 0.1,
                f"RMS {shape:.2g} % after a similarity; the scale is reported with a standard deviation of "
                f"{100 * _rms([m.scale_std for m in maps]):.2g} %",
            )
        )  # fmt: skip
        metrics.append(
            reported(
                f"{kind}: least RMS of that error that accelerometer and sonar allow", least, "%",
                "bound of Cramér and Rao of the scale, with pictures that show the path exactly",
            )
        )  # fmt: skip
    return metrics


def _of_gaps(kind: str, flights: list[Flown]) -> list[Metric]:
    gaps = [flight.gap for flight in flights if flight.gap is not None]
    if not gaps:
        return [reported(f"{kind}: flights whose map crosses the gap", 0, "", f"of {len(flights)}")]
    error, alone = _rms([gap.error_m for gap in gaps]), _rms([gap.navigation_m for gap in gaps])
    least, std = _rms([gap.smoothing_m for gap in gaps]), _rms([gap.std_m for gap in gaps])
    return [
        at_most(
            f"{kind}: error at its end over that of navigation by the IMU alone", error / alone, "x", 1.2,
            f"{1e3 * error:.3g} over {1e3 * alone:.3g} mm; the bound with pictures behind the gap is "
            f"{1e3 * least:.3g} mm; {len(gaps)} of {len(flights)} flights",
        ),
        reported(f"{kind}: that error over its reported standard deviation", error / std, "x"),
        *judged(f"{kind}, position at its end", np.array([gap.nees for gap in gaps]), 2),
    ]  # fmt: skip


def _all(flight: Flown) -> Mapped:
    """Return the map with all instruments that the flight has."""
    return flight.maps.get(ALL) or flight.maps[NO_SONAR]


def _without(flights: Sequence[Flown], less: str) -> float:
    """Return the error with ``less`` over that with all, over the flights that both map as a whole. Errors
    are shares of the path, so that long flights do not count more."""
    pairs = [(flight.maps.get(less), flight.maps.get(ALL)) for flight in flights]
    both = [(a, b) for a, b in pairs if a and b and a.whole and b.whole]
    return _rms([a.error_m / a.path_m for a, _ in both]) / _rms([b.error_m / b.path_m for _, b in both])


def _listed(ratio: dict[str, float]) -> str:
    return ", ".join(f"{kind} {value:.3g}" for kind, value in ratio.items())


def _rms(values: Sequence[float]) -> float:
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")


def main() -> None:
    """Run the chosen kinds and seeds, and print them."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.instruments", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--cores", type=int, default=CORES)
    chosen = parser.parse_args()
    flights = fly_all(chosen.kinds, chosen.seeds, chosen.cores)
    for flight in flights:
        print(json.dumps(asdict(flight)), flush=True)
    screen = Console(width=150)
    from tests.benchmarks.run import Record, shown

    screen.print(shown(Record("instruments", tuple(figures(flights)), "", 0.0, "")))


if __name__ == "__main__":
    main()
