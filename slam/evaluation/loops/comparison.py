"""Loop closure of one flight, stage by stage, compared with common alternative methods.

Retrieval ranks all pairs that are far enough apart in time. The most similar pairs of each keyframe are
registered, and accepted registrations are ranked by their inliers. Exhaustive matching registers every pair:
no retrieval can let more through. The last stage is the map, which uses all that the pipeline knows of its
poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from backend.measurements import LinkCheck
from frontend.camera import Camera
from frontend.loops import signatures, verify
from frontend.store import FeatureStore
from slam.core.arguments import check_flight
from slam.core.errors import NO_CAMERA, InputError
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.core.stage_timer import Stopwatch
from slam.evaluation.loops.curve import Curve, precision_recall
from slam.evaluation.loops.methods import bags_of_words, colour_histogram
from slam.evaluation.loops.reference import FALSE, TRUE, UNDECIDED, Pair, Reference, reference_of
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.pipeline import optimize_with_observations

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

OURS, HISTOGRAM, WORDS, EXHAUSTIVE = "ours (VLAD)", "colour histogram", "bag of words", "exhaustive matching"
MOST_KEYFRAMES = 250
"""Largest number of keyframes whose pairs are all registered; a longer flight is subsampled evenly."""


_STAGES = (
    "look alike or should overlap",
    "within reach of the poses",
    "a homography holds",
    "where the poses can have it",
    "in the map",
)
"""Stages that a candidate of the pipeline must pass, in order."""


@dataclass(frozen=True)
class Counts:
    """Number of pairs that are loops, that are not, and that count neither way."""

    true: int
    false: int
    undecided: int

    @staticmethod
    def of(labels: NDArray[np.int64]) -> Counts:
        """Count pairs by their label."""
        return Counts(*(int((labels == label).sum()) for label in (TRUE, FALSE, UNDECIDED)))


@dataclass(frozen=True)
class MethodScore:
    """Results of one method of loop detection."""

    name: str
    candidates: Curve | None
    """Curve of all pairs by similarity; None for exhaustive matching, which has no ranking."""
    proposed: Counts
    """Counts of the most similar pairs of each keyframe, which are registered."""
    verified: Counts
    """Counts of the registered pairs that are accepted."""
    after_verification: Curve
    """Curve of the accepted pairs by their inliers."""


@dataclass(frozen=True)
class Stage:
    """Number of the pipeline's own candidates that remain after the stage."""

    name: str
    counts: Counts


@dataclass(frozen=True)
class LoopEvaluation:
    """All results in ``loops.json`` and ``loops.png``."""

    name: str
    reference: Reference
    frames: int
    keyframes: int
    compared: int
    """Number of keyframes whose pairs were all registered."""
    true_pairs: int
    """Counts of the pairs of those keyframes."""
    pairs: int
    neighbours: int
    """Number of candidates a keyframe."""
    methods: tuple[MethodScore, ...]
    stages: tuple[Stage, ...]
    """Stages of the pipeline, over all keyframes."""
    kept: tuple[Pair, ...]
    """Counts of the loops in the map."""
    all_true_pairs: int
    """Counts of the true and false pairs over all keyframes."""
    timing_s: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def status(self) -> str:
        """Status word: ``ok``, or the reason why nothing could be measured."""
        return (
            "ok"
            if self.true_pairs
            else "no true loop in this flight: recall is not defined; fly over one place twice"
        )


def evaluate_loops(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> LoopEvaluation:
    """Compute precision and recall of loop closure on a flight with truth or GPS.

    Raises ``InputError`` where it has neither, no pictures, or too few keyframes for a loop.
    """
    check_flight(flight)
    if flight.camera is None or flight.frames is None or len(flight.frames) == 0:
        why = flight.reason_not_read("cam0") or "no camera in this flight"
        raise InputError(f"{flight.name}: {why}, so no loops to find; {NO_CAMERA}")
    if not any(stream is not None and len(stream.stamps_s) for stream in (flight.truth, flight.gps)):
        raise InputError(
            f"{flight.name}: has neither truth nor GPS to judge loops by; "
            "add state_groundtruth_estimate0 or gps0"
        )
    clock = Stopwatch()
    with clock("map"):
        estimate, observations = optimize_with_observations(flight, config, progress)
    reference = reference_of(estimate, flight)
    known = np.flatnonzero(reference.known)
    chosen = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), MOST_KEYFRAMES)).astype(int))]
    pairs = reference.eligible(chosen)
    labels = reference.labels(pairs)
    with clock("exhaustive"), threadpool_limits(1, "blas"):
        inliers = _registered(pairs, observations.store, flight.camera, config, progress)
    likeness = {}
    for name in (OURS, HISTOGRAM, WORDS):
        with clock(name), threadpool_limits(1, "blas"):
            vectors = _vectors(name, observations.store, chosen, flight, estimate, config, progress)
            likeness[name] = _inner(vectors, chosen, pairs)
    neighbours = config.retrieval.neighbours
    methods = [
        score_method(name, likeness[name], inliers, pairs, labels, neighbours)
        for name in (OURS, HISTOGRAM, WORDS)
    ]
    warnings = list(estimate.warnings)
    if len(chosen) < len(known):
        warnings.append(
            f"{len(chosen)} of {len(known)} keyframes, evenly spread, are compared with one another"
        )
    if len(known) < len(estimate.stamps_s):
        warnings.append(f"{len(estimate.stamps_s) - len(known)} keyframes have no {reference.kind}: left out")
    if reference.position_std_m > 0:
        warnings.append(
            f"GPS positions are known to {reference.position_std_m:.1f} m: undecided pairs do not count"
        )
    return LoopEvaluation(
        name=flight.name,
        reference=reference,
        frames=estimate.frames,
        keyframes=len(estimate.stamps_s),
        compared=len(chosen),
        true_pairs=int((labels == TRUE).sum()),
        pairs=len(pairs),
        neighbours=neighbours,
        methods=(*methods, score_exhaustive(inliers, labels)),
        stages=stages_of(estimate.loops, observations, reference),
        kept=tuple((v.i, v.j) for v in estimate.loops if v.verdict == "kept"),
        all_true_pairs=int((reference.labels(list(reference.overlap)) == TRUE).sum()),
        timing_s=clock.seconds,
        warnings=tuple(warnings),
    )


def score_method(
    name: str,
    likeness: Array,
    inliers: Array,
    pairs: NDArray[np.int64],
    labels: NDArray[np.int64],
    neighbours: int,
) -> MethodScore:
    """Evaluate a similarity (m,) of pairs (m, 2); ``inliers`` (m,) is 0 where a registration is not
    accepted."""
    proposed = most_alike(likeness, pairs, neighbours)
    total = int((labels == TRUE).sum())
    return MethodScore(
        name,
        _curve(likeness, labels, total),
        Counts.of(labels[proposed]),
        Counts.of(labels[proposed & (inliers > 0)]),
        _curve(np.where(proposed, inliers, 0.0), labels, total, above=0.0),
    )


def score_exhaustive(inliers: Array, labels: NDArray[np.int64]) -> MethodScore:
    """Evaluate exhaustive matching: every pair is registered."""
    curve = _curve(inliers, labels, int((labels == TRUE).sum()), above=0.0)
    return MethodScore(EXHAUSTIVE, None, Counts.of(labels), Counts.of(labels[inliers > 0]), curve)


def most_alike(likeness: Array, pairs: NDArray[np.int64], neighbours: int) -> NDArray[np.bool_]:
    """(m,) whether a pair is among the ``neighbours`` most similar of one of its two keyframes."""
    twice = np.concatenate([pairs[:, 0], pairs[:, 1]])
    row = np.tile(np.arange(len(pairs)), 2)
    order = np.lexsort((-likeness[row], twice))
    begin = np.flatnonzero(np.diff(twice[order], prepend=-1))
    place = np.arange(len(order)) - np.repeat(begin, np.diff(begin, append=len(order)))
    chosen = np.zeros(len(pairs), dtype=bool)
    chosen[row[order[place < neighbours]]] = True
    return chosen


def _curve(score: Array, labels: NDArray[np.int64], total: int, above: float = -np.inf) -> Curve:
    counts = (labels != UNDECIDED) & (score > above)
    return precision_recall(score[counts], labels[counts] == TRUE, total)


def _registered(
    pairs: NDArray[np.int64], store: FeatureStore, camera: Camera, config: PipelineConfig, progress: Progress
) -> Array:
    """(m,) inliers of each pair's registration; 0 where it is not accepted."""
    found = verify(
        [(int(i), int(j)) for i, j in pairs],
        store,
        camera,
        config.homography.for_width(camera.size_px[0]),
        config.gates,
        on_done=lambda done: progress("every pair", done, len(pairs)),
    )
    return np.array([float(len(r.matches)) if r.ok else 0.0 for r in found])


def _vectors(
    name: str,
    store: FeatureStore,
    chosen: NDArray[np.int64],
    flight: Flight,
    estimate: Estimate,
    config: PipelineConfig,
    progress: Progress,
) -> Float32:
    """(n, d) one vector a keyframe; zeros for keyframes that are not chosen, where that is cheaper."""
    if name == OURS:
        return signatures(store, config.retrieval)
    if name == WORDS:
        return bags_of_words(store)
    assert flight.frames is not None
    rows: dict[int, Float32] = {}
    for done, k in enumerate(chosen.tolist(), 1):
        image = flight.frames.load(int(estimate.frame_index[k]))
        if image is not None:
            rows[k] = colour_histogram(image)
        progress("histograms", done, len(chosen))
    size = max((len(row) for row in rows.values()), default=1)
    vectors = np.zeros((len(estimate.stamps_s), size), np.float32)
    for k, row in rows.items():
        vectors[k, : len(row)] = row
    return vectors


def _inner(vectors: Float32, chosen: NDArray[np.int64], pairs: NDArray[np.int64]) -> Array:
    """(m,) inner products of the pairs' vectors."""
    table = vectors[chosen] @ vectors[chosen].T
    a, b = (np.searchsorted(chosen, side) for side in pairs.T)
    return np.asarray(table[a, b].astype(float))


def stages_of(
    loops: Sequence[LoopVerdict], observations: Observations, reference: Reference
) -> tuple[Stage, ...]:
    """Count the pipeline's candidates that remain after each stage; the last is the map."""
    reason = {(r.i, r.j): r.reason for r in observations.refused if r.reason}

    def passed(v: LoopVerdict) -> int:
        """Return the number of stages that a candidate passed."""
        pair = (v.i, v.j)
        if v.verdict == "kept":
            return len(_STAGES)
        if pair not in reason:  # the graph rejected it
            return len(_STAGES) - 1
        if pair in observations.contradicted:
            return 3
        return 1 if reason[pair].check is LinkCheck.REACH else 2

    reached = [(passed(v), (v.i, v.j)) for v in loops]
    return tuple(
        Stage(name, Counts.of(reference.labels([pair for count, pair in reached if count >= number])))
        for number, name in enumerate(_STAGES, 1)
    )
