"""Choice of the motion that separates two causes best. Each is simulated with a healthy vehicle.

The separation in sigmas is that of the first term's size, with the other term and the nuisances free. Without
commands, motions of a hand are tried as well; the columns of the effects are then those of the inertial
comparisons, and of points of a bare floor (`planned_matches`), with the noise of the flights at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from frontend.cores import in_threads
from slam.core.progress import Progress, Tally, silent
from slam.criticism.camera.camera_path import MARGIN_S, camera_path
from slam.criticism.camera.lens import floor_of, pixels_of
from slam.criticism.kalman.filter_parameters import CAMERA, FilterParameters, filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.readings import SLOPE_X, SLOPE_Y, STREAMS
from slam.criticism.kalman.record import Record, record_of
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import MEAN_NUISANCES
from slam.criticism.search.information import fisher_information
from slam.criticism.search.quadratic_likelihood import QuadraticLikelihood
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.posterior import Posterior
from slam.criticism.without_commands.likelihood import likelihood_of, picture_rows
from slam.criticism.without_commands.sensor_comparison import airborne_record, with_free_motion
from slam.data_quality.pictures.cells import CELL_STEPS, Cells
from slam.data_quality.pictures.feature_matches import MATCHES, STEPS, FeatureMatches
from slam.data_quality.pictures.tones import FEWEST as FEWEST_POINTS
from slam.data_quality.whitened_rows import WhitenedRows, begin_of, inertial_residuals, noise_of
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight, simulate_readings
from slam.simulation.healthy.handheld_motions import HANDHELD_MOTIONS, handheld_motion
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import Model

DISTINGUISHED_SIGMA = 3.3
"""Separation at which two terms are distinguished in nineteen of twenty cases."""
MOST_PAIRS = 3
PRINTED = 0.005
"""Least probability that is not printed as 0.00."""
NONE = "No manoeuvre of the list"
SHORTEST_S = 14.0
"""Least duration of a motion for comparisons, which need some rows: a shorter one is repeated."""
MOST_TIMES = 3
"""Greatest number of flights that are advised: a motion that has to be flown more often is no advice."""


def next_flight(model: Model, found: SearchResult, posterior: Posterior, progress: Progress) -> str:
    """Return advice on the next flight, in a sentence, for the first pair of a chosen term and an alternative
    that a manoeuvre separates; empty where there is no such pair.

    Pairs of which both are probable come first. A cause of next to no probability needs no flight.
    """
    probability = posterior.probability
    pairs = [
        (min(probability.get(effect.name, 0.0), probability.get(name, 0.0)), effect, name)
        for effect, place in zip(found.chosen, posterior.places, strict=True)
        for name in place.names[1:]
    ]
    kinds = {int(kind) for record in found.records for kind in np.unique(record.kinds)}
    seen = next((record.matches for record in found.records if record.matches is not None), None)
    advised = ""
    for least, effect, name in sorted(pairs, key=lambda pair: -pair[0])[:MOST_PAIRS]:
        if least < PRINTED:
            break
        if effect.is_saturation:
            # No slope shows it: the first expansion has it at values of a grid, and the other's size.
            other, effect = (_best_way(found.first, n) for n in (effect.name, name))
            expansion, chosen = found.first, [effect]
        else:
            other, expansion, chosen = _best_way(found.last, name), found.last, [*found.chosen]
        step, _ = expansion.maximise(chosen).of(effect.columns)
        # The value of a nuisance is its difference from the healthy vehicle's own.
        current = {n.name: n.value_in(expansion.parameters) - n.value_in(found.model) for n in MEAN_NUISANCES}
        size = step + [(expansion.current | current).get(column, 0.0) for column in effect.columns]
        sentence = telling_flight(model, effect, other, size, kinds, seen, progress)
        if sentence and not sentence.startswith(NONE):
            return sentence
        advised = advised or sentence
    return advised


def telling_flight(
    model: Model,
    first: Effect,
    second: Effect,
    sizes: np.ndarray,
    kinds: Container[int],
    seen: FeatureMatches | None = None,
    progress: Progress = silent,
) -> str:
    """Return a sentence naming the manoeuvre that best separates two terms, the first with sizes (columns,).

    It is the best for the time that it takes, with these ``kinds`` of instruments and a camera as in
    ``seen``. The sentence is empty for a term that moves no mean.
    """
    if first.changes:
        return ""
    parameters, slower = filter_parameters_of(model), at_lower_rates(model)
    beside = [] if second.changes else [second]

    def sigma(name: str) -> float:
        flight = simulate_flight(slower, stick_for([name]), 1)
        missing = {stream: None for kind, stream in enumerate(STREAMS) if kind not in kinds}
        record = referred(record_of(replace(flight, **missing)), parameters)  # type: ignore[arg-type]
        if seen is not None:
            record = replace(record, matches=planned_matches(record, parameters, seen))
        fisher = fisher_information([record], parameters, [first, *beside], MEAN_NUISANCES)
        fisher = replace(fisher, score=np.zeros_like(fisher.score))
        quadratic = QuadraticLikelihood(fisher, parameters, parameters, MEAN_NUISANCES)
        return separation(quadratic, first, beside, sizes)

    return _best_motion(first.name, second.name, list(MANOEUVRES), sigma, progress)


def next_motion(
    model: Model,
    found: SearchResult,
    rows: Sequence[Sequence[WhitenedRows]],
    rivals: Sequence[str],
    seen: FeatureMatches | None = None,
    progress: Progress = silent,
) -> str:
    """Return a sentence naming the motion that separates two rivals best for the time that it takes.

    ``rows`` are those of the flights at hand; the first rival is one of the chosen effects of ``found``. A
    camera is on board as in ``seen``.
    """
    effect, other = (next(e for e in found.last.effects if e.name == name) for name in rivals)
    if not any(column in CAMERA for rival in (effect, other) for column in rival.columns):
        # Pictures would cost a path for each motion, and the other comparisons separate errors of
        # instruments.
        seen = None
    maximum = found.last.maximise(found.chosen)
    size, error = maximum.of(effect.columns)
    _, plain = maximum.of(effect.columns, white=True)
    wider = float(np.sqrt(np.max(np.diag(error) / np.diag(plain))))
    parameters = with_free_motion(filter_parameters_of(model))
    noise, beside = noise_of(rows), [*(e for e in found.chosen if not e.repeats(effect)), other]

    def sigma(name: str) -> float:
        times = int(np.ceil(SHORTEST_S / _took_s(name)))  # a short motion is repeated
        if name in MANOEUVRES:
            flight = simulate_flight(model, stick_for([name] * times), 1)
        else:
            moved = handheld_motion(name, times)
            flight = simulate_readings(model, model, moved, False, 1, np.random.default_rng(1))
        rows = inertial_residuals(flight)
        if seen is not None and (record := airborne_record(flight)) is not None:
            planned_record = replace(record, matches=planned_matches(record, parameters, seen))
            rows += picture_rows(planned_record, parameters, {}, begin_of(rows))
        planned = [r for r in rows if r.kind in noise]
        if not planned:
            return 0.0
        finer = noise_of([planned])
        # A row weighs by the ratio of its precision to that of the flights at hand.
        each = [(r, finer[r.kind] / noise[r.kind]) for r in planned]
        weighed = [replace(r, traces={n: w * x for n, x in r.traces.items()}, off=w * r.off) for r, w in each]
        expansion = likelihood_of([weighed], parameters).last
        known = {e.name: e for e in expansion.effects}
        if effect.name not in known or known[effect.name].columns != effect.columns:
            return 0.0
        others = [known[e.name] for e in beside if e.name in known]
        return separation(expansion, effect, others, size) / wider / float(np.sqrt(times))

    return _best_motion(rivals[0], rivals[1], [*MANOEUVRES, *HANDHELD_MOTIONS], sigma, progress)


def _took_s(name: str) -> float:
    return stick_for([name]).duration_s if name in MANOEUVRES else handheld_motion(name).duration_s


def _best_motion(
    first: str, second: str, names: Sequence[str], sigma: Callable[[str], float], progress: Progress
) -> str:
    """Return the advice on the motions of some ``names``, each of which separates two terms by ``sigma``."""
    found = in_threads(Tally(progress, "next flight", len(names)).counting(sigma), names)
    motions = [f"fly {name!r}" if name in MANOEUVRES else f"{name}," for name in names]
    return advice(first, second, motions, found, [_took_s(name) for name in names])


def separation(
    quadratic: QuadraticLikelihood, effect: Effect, beside: Sequence[Effect], size: NDArray[np.float64]
) -> float:
    """Return the sigmas by which an effect of some ``size`` (columns,) stands out, ``beside`` free."""
    _, covariance = quadratic.maximise([*beside, effect]).of(effect.columns, white=True)
    return float(np.sqrt(size @ np.linalg.solve(covariance, size)))


def advice(
    first: str, second: str, motions: Sequence[str], sigma: Sequence[float], took_s: Sequence[float]
) -> str:
    """Return the sentence for the best of ``motions``, which separate two terms by ``sigma`` in ``took_s``.

    The best is the quickest that needs few flights. Separation grows as the root of the time flown.
    """
    times = np.ceil((DISTINGUISHED_SIGMA / np.maximum(sigma, 1e-3)) ** 2)
    if times.min() > MOST_TIMES:
        best = int(np.argmax(sigma))
        return (
            f"{NONE} distinguishes {first} from {second} in {MOST_TIMES} flights; another "
            f"sensor is needed. The best is to {motions[best]}: {sigma[best]:.1f} sigma a time."
        )
    best = int(np.argmin(np.where(times <= MOST_TIMES, times * np.array(took_s), np.inf)))
    often = f"{'once, for' if times[best] == 1 else f'{times[best]:.0f} times, each'} {took_s[best]:.0f} s"
    return f"To distinguish {first} from {second} {motions[best]} {often}: {sigma[best]:.1f} sigma a time."


def _best_way(expansion: LikelihoodExpansion, name: str) -> Effect:
    """Return the way of trying a term that explains most by itself."""
    return expansion.score_tests([], [e for e in expansion.effects if e.name == name])[0].effect


GRID = round(np.sqrt(MATCHES))
BORDER_SHARE = 0.05
"""Smallest distance of a feature to the edge, as a share of the picture's width."""
LEVELS, DETAIL = (60.0, 180.0), (5.0, 20.0)
"""Ranges of a floor's grey levels, and of their standard deviation around a point."""
TONE_NOISE, CELL_NOISE = 0.02, 0.02
"""Relative noise of the tones of a point, and of a cell, from picture to picture."""


def planned_matches(record: Record, parameters: FilterParameters, like: FeatureMatches) -> FeatureMatches:
    """Return matches of the flight of ``record``, with the rate and pixel noise of the matches ``like``.

    No picture is rendered. Points lie on a grid of the later picture and are transferred into the earlier one
    by the predicted path; their tones are random. The information on an error depends on the positions of the
    points and on their noise, not on the texture of the floor.
    """
    every_s = float(np.median(np.diff(like.stamps_s)))
    stamps_s = np.arange(record.times_s[0] + MARGIN_S, record.times_s[-1] - MARGIN_S, every_s)
    along = camera_path(record, replace(like, stamps_s=stamps_s), parameters)
    shown = np.flatnonzero(along.inside)
    pairs = [(j - step, j) for j in range(len(shown)) for step in STEPS if j >= step]
    i, j = np.repeat(np.array(pairs, dtype=np.int64).reshape(-1, 2), GRID**2, axis=0).T
    width, height = like.camera.size_px
    border = BORDER_SHARE * width
    x, y = np.linspace(border, width - border, GRID), np.linspace(border, height - border, GRID)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixel_j = np.tile(grid, (len(pairs), 1))
    camera, slope = parameters.camera, parameters.sensor[[SLOPE_X, SLOPE_Y]]
    floor = floor_of(like.camera, camera, along.poses[j], pixel_j, slope)
    pixel_i = pixels_of(like.camera, camera, along.poses[i], floor)
    edge = 0.5 * grid.min(axis=0)
    kept = ((pixel_i > edge) & (pixel_i < like.camera.size_px - edge)).all(axis=1)
    # Pictures with too little overlap cannot be registered.
    kept &= np.repeat(kept.reshape(-1, GRID**2).sum(axis=1) >= FEWEST_POINTS, GRID**2)
    i, j, pixel_i, pixel_j = i[kept], j[kept], pixel_i[kept], pixel_j[kept]
    rng = np.random.default_rng(0)
    near = np.isin(j - i, CELL_STEPS)
    cells = Cells(
        shown[i[near]], shown[j[near]], pixel_i[near], pixel_j[near],
        rng.normal(0.0, CELL_NOISE, int(near.sum())),
    )  # fmt: skip
    tone = np.column_stack([rng.uniform(*LEVELS, (len(i), 3)), rng.uniform(*DETAIL, len(i))])
    tone_i, tone_j = (tone * (1.0 + TONE_NOISE * rng.standard_normal(tone.shape)) for _ in range(2))
    std_px = np.full(len(i), float(np.median(like.std_px)))
    return replace(
        like, stamps_s=stamps_s, earlier=shown[i], later=shown[j], pixel_i=pixel_i, pixel_j=pixel_j,
        std_px=std_px, tone_i=tone_i, tone_j=tone_j, cells=cells, taken=len(stamps_s), missing=0,
        lens_distortion=replace(like.lens_distortion, pictures=len(stamps_s)), flicker=0.0,
        moving_s=np.zeros(0), spots=np.zeros((0, 3)),
    )  # fmt: skip
