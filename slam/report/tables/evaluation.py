"""Tables of an evaluation: errors against the reference, and the paper's landmark distances on three maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted, either
from slam.core.estimate import MAP_TRAJECTORIES
from slam.core.figure_table import UNKNOWN, FigureTable
from slam.core.units import length
from slam.evaluation.coarse_truth import BETWEEN_ROWS
from slam.evaluation.landmarks import LandmarkPlace, over_papers_ground
from slam.evaluation.paper_values import EKF_PERCENT, STITCHED_PERCENT
from slam.report.tables.check_points import checked_lengths, off_check_points
from slam.report.tables.truth import clock_of_truth, rows_about_truth, too_coarse_to_tell, unit_of_truth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slam.core.control_points import ControlReport
    from slam.core.flight import Flight
    from slam.evaluation.keyframe_by_keyframe import KeyframeByKeyframe
    from slam.evaluation.map_gain import MapGain
    from slam.evaluation.nees import Consistency
    from slam.evaluation.score import Evaluation
    from slam.mapping.live.mapper import LiveState

_NEES = "is the stated uncertainty right?"


@dataclass(frozen=True)
class Evaluated:
    """The comparison of a map with its reference."""

    words: str = (
        "Not measured here: the accuracy above is what the map states of itself. Where a true path, known "
        "distances or GPS are at hand, the command slam evaluate compares the map with them, and writes the "
        "result here."
    )
    tables: tuple[FigureTable, ...] = ()
    checks_lengths: bool = False
    """Whether known distances on the ground were compared with those on the map."""
    landmarks: tuple[LandmarkPlace, ...] = ()
    """The landmarks that were compared, where the map has them."""
    chain_landmarks: tuple[LandmarkPlace, ...] = ()
    """The same on the map of the plain chain, once for each visit."""


NOT_EVALUATED = Evaluated()
"""The words for a map that was not compared."""


EVALUATE = "slam evaluate OUT --truth FLIGHT (OUT is the folder of this page, FLIGHT that of the flight)"
"""Command that compares a map with the truth of its flight, in a sentence."""


def not_evaluated(flight: Flight | None, control: ControlReport | None = None) -> Evaluated:
    """Return the words for a map that no evaluation compared: its check points, or a reference of its flight,
    check it."""
    if control is not None and control.checks:
        return checked_by_points(control)
    if flight is None or flight.truth is None:
        return NOT_EVALUATED
    return Evaluated(
        f"Not measured yet, but this flight holds a true path: the command {EVALUATE} compares the map "
        "with it, and writes the result here."
    )


def checked_by_points(control: ControlReport) -> Evaluated:
    """Return the comparison of a map with its check points."""
    lengths = checked_lengths(control)
    sentences = (off_check_points(control), lengths, "The table below has each point.")
    return Evaluated(" ".join(filter(None, sentences)), checks_lengths=bool(lengths))


def evaluated(evaluation: Evaluation) -> Evaluated:
    """Return the comparison: the errors of a map, and whether its uncertainty and its loops are right."""
    lines = (_map_against_truth(evaluation), _loops_against_truth(evaluation))
    known = evaluation.metric and any(np.isfinite(row.error_m.loops) for row in evaluation.landmarks)
    return Evaluated(
        " ".join(filter(None, lines)),
        accuracy_tables(evaluation),
        known,
        evaluation.landmarks_on_map,
        evaluation.landmarks_on_chain,
    )


def _loops_against_truth(evaluation: Evaluation) -> str:
    loops = evaluation.loops
    if loops is None or not loops.true_kept + loops.false_kept:
        return ""
    return (
        f"By the truth, {loops.false_kept} of {loops.true_kept + loops.false_kept} kept matches are false"
        + (f"; of {loops.undecided_kept} more it cannot tell." if loops.undecided_kept else ".")
    )


def _map_against_truth(evaluation: Evaluation) -> str:
    if not evaluation.metric:
        return "Its lengths are no metres: the table below compares them with their scale aligned."
    whom = "the true path recorded with the flight" if evaluation.reference == "truth" else "the GPS"
    error = evaluation.ate_m
    if not np.isfinite(error.rmse):
        return f"{counted(evaluation.associated, 'keyframe')} can be compared, too few to tell errors."
    text = (
        f"Typically {length(error.rmse)} and at most {length(error.max)}, compared with {whom}, at "
        f"the cameras of {evaluation.associated} keyframes."
    )
    if evaluation.landmarks:
        ways = [row.error_percent for row in evaluation.landmarks]
        with_loops, without = (
            _largest([getattr(way, name) for way in ways]) for name in ("loops", "odometry")
        )
        text += (
            f" Distances between landmarks are wrong by {_percent(with_loops)} at most "
            f"({_percent(without)} without loop closures). These known distances check its lengths."
        )
    if evaluation.truth_clock is not None:
        text += f" But {clock_of_truth(evaluation.truth_clock)}."
    if evaluation.too_few_rows is not None:
        text += f" But {too_coarse_to_tell(evaluation.too_few_rows)}."
    if evaluation.nees is not None:
        pose = evaluation.nees.pose
        if evaluation.too_few_rows is not None:
            text += " For the same reason it does not tell whether the stated uncertainty is right."
        elif pose.mean > pose.upper95:
            text += (
                " The errors of places and angles together are larger than the stated uncertainty allows: "
                f"trust it less. Those of places alone are {as_stated(evaluation.nees.position)}."
            )
        else:
            text += (
                " The errors of places and angles together are no larger than the stated uncertainty allows. "
                "Plan with it as it is. On one flight they may be far smaller, because an error that all "
                "lengths share is drawn once. Those of places alone are "
                f"{as_stated(evaluation.nees.position)}."
            )
    return text


def as_stated(errors: Consistency) -> str:
    """Return how large errors are beside the stated ones, and which sizes chance alone allows."""
    size, low, high = (np.sqrt(nees / errors.dof) for nees in (errors.mean, errors.lower95, errors.upper95))
    return (
        f"{size:.2f} times as large as stated, where each direction counts by what is stated for it (chance "
        f"alone gives {low:.2f} to {high:.2f} times)"
    )


def accuracy_tables(evaluation: Evaluation) -> tuple[FigureTable, ...]:
    """Return all tables of an evaluation; that of the landmarks only where there are any."""
    against = _against_reference(evaluation)
    if not evaluation.landmarks:
        return (against,)
    return landmark_table(evaluation), against


def landmark_table(evaluation: Evaluation) -> FigureTable:
    """Table of the errors of landmark distances on our three maps, and the paper's two where its pairs were
    flown."""
    names = [row.name for row in evaluation.landmarks]
    theirs = (STITCHED_PERCENT, EKF_PERCENT) if over_papers_ground(evaluation.landmarks) else ()
    rows = []
    for row in evaluation.landmarks:
        way = row.error_percent
        figures = [*(column[row.name] for column in theirs), way.chain, way.odometry, way.loops]
        rows.append((row.name, f"{row.truth_m:.3f} m", *(_percent(figure) for figure in figures)))
    ways = [row.error_percent for row in evaluation.landmarks]
    columns = [
        *([column[name] for name in names] for column in theirs),
        [way.chain for way in ways],
        [way.odometry for way in ways],
        [way.loops for way in ways],
    ]
    rows.append(("largest", "", *(_percent(_largest(column)) for column in columns)))
    for gap in evaluation.loop_gaps:
        errors = (gap.error_m.chain, gap.error_m.odometry, gap.error_m.loops)
        ours = (_length(error) for error in errors)
        rows.append((f"gap {gap.name}, and its error", f"{gap.truth_m:.3f} m", *("" for _ in theirs), *ours))
    headings = ("paper, stitched", "paper, filter") if theirs else ()
    return FigureTable(
        "Error of the distances between landmarks on the map; chain: each picture placed by the one before"
        + ("" if evaluation.metric else "; the scale of the maps is aligned")
        + ("; paper: Visser and others 2011" if theirs else ""),
        ("landmarks", "true", *headings, *_columns(evaluation.trajectory_names)),
        tuple(rows),
    )


def map_gain_table(gains: Sequence[MapGain]) -> FigureTable:
    """Table of the errors of maps as recorded, and after the correction of the instrument errors."""
    rows = []
    for gain in gains:
        named = f"{gain.flight}: " if len(gains) > 1 else ""
        both = (gain.before, gain.after)
        rows.append(
            (f"{named}position error, start and heading aligned", *(_length(e.position_m) for e in both))
        )
        rows.append((f"{named}scale error of the map", *(_percent(100 * (1 / e.scale - 1)) for e in both)))
        if any(np.isfinite(e.landmarks_percent) for e in both):
            shown = (_percent(e.landmarks_percent) for e in both)
            rows.append((f"{named}largest error of a distance between landmarks", *shown))
        nees = (f"{e.nees:.3g}" if np.isfinite(e.nees) else UNKNOWN for e in both)
        rows.append((f"{named}{_NEES} NEES, 6 if so", *nees))
    return FigureTable("Gain of the model in the map", ("", "as recorded", "corrected"), tuple(rows))


def keyframe_by_keyframe_table(found: KeyframeByKeyframe) -> FigureTable:
    """Table of the incremental back end beside the batch."""
    unit_of, ms = found.length_unit, 1e3 * found.seconds
    times = f"{np.median(ms):.2g}, {np.percentile(ms, 99):.2g}, {ms.max():.2g}"
    rejected = f"{found.rejected_in_flight}, {found.rejected_by_batch}"
    rows = (
        ("keyframes, loops", f"{len(ms)}, {found.loops}"),
        ("keyframes that the IMU alone joins to earlier ones", str(found.bridged)),
        ("time for a keyframe, median, 99 of 100, longest", f"{times} ms"),
        ("edges rejected at the end of the flight, by the batch", rejected),
        ("loops that waited at the end of the flight, to keep the time", str(found.waiting)),
        ("RMS distance to the batch, each keyframe when it was added", f"{found.when_added:.3g} {unit_of}"),
        ("the same, all keyframes at the end of the flight", f"{found.in_flight:.3g} {unit_of}"),
        ("the same, after the final solve", f"{found.settled:.3g} {unit_of}"),
    )
    return FigureTable("The pose graph keyframe by keyframe, beside the batch", (), rows)


def _length(metres: float) -> str:
    return length(metres) if np.isfinite(metres) else UNKNOWN


def _columns(ways: tuple[str, str, str]) -> tuple[str, str, str]:
    return ("chain", *ways[1:]) if ways == MAP_TRAJECTORIES else ways


def _against_reference(evaluation: Evaluation) -> FigureTable:
    start = "nothing aligned" if evaluation.reference == "gps" else "start and heading aligned"
    rows = [
        (
            f"keyframes compared with {evaluation.reference}",
            f"{evaluation.associated} of {evaluation.keyframes}" + _between_rows(evaluation),
        ),
        (f"position error, {start}", _spread(evaluation.ate_m.rmse, evaluation.ate_m.max)),
        (
            "position error, rigidly aligned",
            _spread(evaluation.ate_aligned_m.rmse, evaluation.ate_aligned_m.max),
        ),
        (
            "position error, aligned with scale"
            + (f" {evaluation.scale:.4f}" if np.isfinite(evaluation.scale) else ""),
            _spread(evaluation.ate_sim3_m.rmse, evaluation.ate_sim3_m.max),
        ),
    ]
    rows += rows_about_truth(evaluation)
    if not evaluation.metric:
        rows.insert(
            0,
            (
                "lengths of the map",
                "in units of the camera's mean height: compare only the figures aligned with scale",
            ),
        )
    coarse = f"the truth has too few rows for how fast the vehicle moves at {evaluation.too_coarse} keyframes"
    if evaluation.nees is not None:
        pose = evaluation.nees.pose
        band = f"{pose.lower95:.2f} to {pose.upper95:.2f}"
        without = f"; {coarse}, left out" if evaluation.too_coarse else ""
        verdict = (
            "not known, the truth is too coarse to tell"
            if evaluation.too_few_rows is not None
            else "no, it is too small"
            if pose.mean > pose.upper95
            else "it is larger than needed"
            if pose.mean < pose.lower95
            else "yes"
        )
        rows.append((_NEES, f"{verdict}: NEES {pose.mean:.2f}, right if {band}{without}"))
    elif evaluation.too_coarse and not unit_of_truth(evaluation):
        rows.append((_NEES, f"cannot be judged: {coarse}"))
    if evaluation.loops is not None:
        loops = evaluation.loops
        judged = f"{_share(loops.precision)} of {loops.true_kept + loops.false_kept}"
        if loops.undecided_kept:
            judged += f", {loops.undecided_kept} more undecided"
        rows.append(("loops kept that are true", judged))
        rows.append(
            ("true revisits that were found and kept", f"{_share(loops.recall)} of {loops.true_pairs}")
        )
        rows.append(("keyframes with a true loop that have one", _share(loops.keyframe_recall)))
    return FigureTable("Against the reference", (), tuple(rows))


def _between_rows(evaluation: Evaluation) -> str:
    count = evaluation.left_out.get(BETWEEN_ROWS, 0)
    return f"; {count} left out: {either(count, 'it is', 'they are')} {BETWEEN_ROWS}" if count else ""


def _largest(figures: list[float]) -> float:
    known = [figure for figure in figures if np.isfinite(figure)]
    return max(known) if known else float("nan")


def _percent(value: float) -> str:
    return f"{value:.2f} %" if np.isfinite(value) else UNKNOWN


def _share(value: float) -> str:
    return f"{100 * value:.0f} %" if np.isfinite(value) else UNKNOWN


def _spread(rmse: float, largest: float) -> str:
    if not np.isfinite(rmse):
        return UNKNOWN
    return f"typically {length(rmse)} (root mean square), {length(largest)} at most"


def live_table(state: LiveState, error: float, metric: bool) -> FigureTable:
    """Return the figures of a map in flight: ``error`` is that of `slam.evaluation.live_error`."""
    ms = 1000 * np.percentile(state.latency_s, [50, 95, 100]) if len(state.latency_s) else np.full(3, np.nan)
    apart = length(error, metric) if np.isfinite(error) else UNKNOWN
    rows = (
        ("pictures", f"{state.pictures}"),
        ("dropped: they arrived while an earlier one was waiting", f"{state.dropped}"),
        ("arrival to tracked: median, 95 %, largest [ms]", " / ".join(f"{x:.0f}" for x in ms)),
        ("keyframes placed", f"{state.placed} of {state.keyframes}"),
        ("of these behind gaps between pictures, joined by the IMU", f"{state.bridged}"),
        ("loops; edges rejected at the end", f"{state.loops}; {state.rejected}"),
        ("live positions from those of the final map, RMS, aligned with scale", apart),
    )
    return FigureTable("In flight", (), rows)
