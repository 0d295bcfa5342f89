"""Figures of an evaluation. The plotting library's global state is not changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.quantiles import chi_square_quantile
from slam.core.plot_style import (
    BLUE,
    GREY,
    ORANGE,
    PALE_GREY,
    VERMILLION,
    escape_math,
    panel_legend_below,
    png,
    round_factor,
    steady_ticks,
)
from slam.core.units import length
from slam.evaluation.landmarks import over_papers_ground
from slam.evaluation.paper_values import EKF_PERCENT, STITCHED_PERCENT
from slam.evaluation.score import Evaluation, Tracks
from slam.io.atomic import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_REFERENCE, _LOOPS, _ODOMETRY, _CHAIN = "black", BLUE, ORANGE, GREY
_PAPER, _PAPER_EKF = VERMILLION, "#eab08f"
_AXES = "xyz"
_SEEN_SHARE = 0.05
"""Share of the extent of a top view: an error of this size is clearly visible beside the reference's line."""

TRAJECTORY_NAME = "evaluation_trajectory.png"
ERROR_NAME = "evaluation_error.png"


def write_plots(evaluation: Evaluation, out_dir: str | Path) -> tuple[Path, ...]:
    """Write the top view with the landmark errors, and the errors over time; each file completely or not at
    all.

    Raises ``InputError`` where the folder cannot be written.
    """
    figures = {
        TRAJECTORY_NAME: trajectory_figure(evaluation),
        ERROR_NAME: error_figure(evaluation),
    }
    paths = []
    for name, figure in figures.items():
        path = Path(out_dir) / name
        write_whole(path, png(figure, cropped=True))
        paths.append(path)
    return tuple(paths)


def trajectory_figure(evaluation: Evaluation) -> Figure:
    """Draw the top view of the reference and the three maps, and landmark errors with the paper's, if any."""
    from matplotlib.figure import Figure

    with_landmarks = bool(evaluation.landmarks)
    figure = Figure(figsize=(13 if with_landmarks else 7.5, 6.5), dpi=120, layout="constrained")
    if with_landmarks:
        top, bars = figure.subplots(1, 2)
        _landmark_bars(bars, evaluation)
    else:
        top = figure.subplots()
    _top_view(top, evaluation)
    return figure


def _top_view(axes: Axes, evaluation: Evaluation) -> None:
    tracks = evaluation.tracks
    reference = "truth" if evaluation.reference == "truth" else "GPS"
    factor = _error_factor(tracks)
    factor_note = f", error drawn {factor:g} x" if factor > 1 else ""
    odometry, loops = (
        tracks.reference_m + factor * (track - tracks.reference_m)
        for track in (tracks.odometry_m, tracks.loops_m)
    )
    # The widest line is first, so that it is visible on both sides of a line above it.
    axes.plot(*tracks.chain_m[:, :2].T, color=PALE_GREY, lw=5, label=evaluation.trajectory_names[0])
    axes.plot(*tracks.reference_m[:, :2].T, color=_REFERENCE, lw=3.2, label=reference)
    axes.plot(*odometry[:, :2].T, color=_ODOMETRY, lw=1.9, label=evaluation.trajectory_names[1] + factor_note)
    axes.plot(
        *loops[:, :2].T, ".-", color=_LOOPS, lw=0.9, ms=3, label=evaluation.trajectory_names[2] + factor_note
    )
    for name, point in tracks.landmarks_m.items():
        axes.plot(point[0], point[1], "+", color=_REFERENCE, ms=8)
        axes.annotate(escape_math(name), (point[0], point[1]), xytext=(4, 4), textcoords="offset points")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    errors = (
        f"{length(evaluation.ate_m.rmse)} RMS, {length(evaluation.ate_aligned_m.rmse)} rigidly aligned"
        if evaluation.metric
        else f"{length(evaluation.ate_sim3_m.rmse)} RMS, aligned with scale"
    )
    axes.set_title(f"{escape_math(evaluation.name)}: position error {errors}")
    panel_legend_below(axes, 2 if factor_note else 4)


def _error_factor(tracks: Tracks) -> float:
    """Factor by which errors are enlarged, so that tracks closer than a line's width can be distinguished.

    It is the first of 1, 2, 5, 10, ... that makes the largest error visible.
    """
    extent_m = float(np.ptp(tracks.reference_m[:, :2], axis=0).max())
    off = [track - tracks.reference_m for track in (tracks.odometry_m, tracks.loops_m)]
    largest_m = float(np.nanmax([np.linalg.norm(each[:, :2], axis=1) for each in off], initial=0.0))
    return max(1.0, round_factor(_SEEN_SHARE * extent_m / largest_m)) if largest_m > 0 else 1.0


def _landmark_bars(axes: Axes, evaluation: Evaluation) -> None:
    from matplotlib.ticker import NullLocator

    rows = evaluation.landmarks
    series = [
        (evaluation.trajectory_names[0], _CHAIN, [row.error_percent.chain for row in rows]),
        (evaluation.trajectory_names[1], _ODOMETRY, [row.error_percent.odometry for row in rows]),
        (evaluation.trajectory_names[2], _LOOPS, [row.error_percent.loops for row in rows]),
    ]
    if over_papers_ground(rows):
        series += [
            ("paper, stitched (table 3)", _PAPER, [STITCHED_PERCENT[row.name] for row in rows]),
            ("paper, EKF (table 4)", _PAPER_EKF, [EKF_PERCENT[row.name] for row in rows]),
        ]
    width = 0.8 / len(series)
    for k, (label, color, percent) in enumerate(series):
        shown = np.where(np.isfinite(percent), percent, 0.0)
        left = np.arange(len(rows)) - 0.4 + k * width
        axes.bar(left, shown, width, align="edge", color=color, label=label)
    axes.set_xticks(range(len(rows)), [escape_math(row.name) for row in rows])
    # The maps differ by orders of magnitude: below 0.1 % the scale is linear down to zero.
    axes.set_yscale("symlog", linthresh=0.1)
    largest = max(
        (float(np.nanmax(percent)) for _, _, percent in series if np.isfinite(percent).any()), default=0
    )
    axes.set_ylim(0, max(1.2 * largest, 0.12))
    axes.set_yticks(
        [tick for tick in (0, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if tick <= 1.2 * largest]
    )
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylabel("error of the distance [%]")
    axes.set_title("Distances between landmarks")
    panel_legend_below(axes, 3)


def error_figure(evaluation: Evaluation) -> Figure:
    """Draw the position error along x, y and z with two standard deviations, and the NEES below if
    available."""
    from matplotlib.figure import Figure

    tracks = evaluation.tracks
    rows = evaluation.dimensions + (evaluation.nees is not None)
    figure = Figure(figsize=(10, 2.3 * rows), dpi=120, layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, 1, sharex=True))
    factor, unit = (1e3, "mm") if evaluation.ate_m.max < 1 else (1.0, "m")
    for k in range(evaluation.dimensions):
        _error_panel(panels[k], tracks, k, factor, unit)
    panels[0].set_title(f"{escape_math(evaluation.name)}: estimate minus reference, with two sigma")
    if evaluation.nees is not None:
        _nees_panel(panels[-1], evaluation)
    panels[-1].set_xlabel("time since the first keyframe [s]")
    figure.align_ylabels(panels)
    return figure


def _error_panel(axes: Axes, tracks: Tracks, k: int, factor: float, unit: str) -> None:
    error = factor * (tracks.loops_m[:, k] - tracks.reference_m[:, k])
    band = 2 * factor * tracks.std_m[:, k]
    axes.fill_between(tracks.stamps_s, -band, band, color=_LOOPS, alpha=0.2, lw=0)
    axes.plot(tracks.stamps_s, error, ".-", color=_LOOPS, lw=1, ms=3)
    axes.axhline(0, color=_REFERENCE, lw=0.5)
    axes.set_ylabel(f"{_AXES[k]} [{unit}]")
    steady_ticks(axes)


def _nees_panel(axes: Axes, evaluation: Evaluation) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    assert evaluation.nees is not None
    pose = evaluation.nees.pose
    low, high = (chi_square_quantile(quantile, pose.dof) for quantile in (0.025, 0.975))
    axes.axhspan(low, high, color=_REFERENCE, alpha=0.08, lw=0, label="95 % of single poses")
    axes.axhspan(pose.lower95, pose.upper95, color=_LOOPS, alpha=0.25, lw=0, label="95 % band of the mean")
    axes.plot(evaluation.tracks.stamps_s, evaluation.tracks.nees, ".", color=_LOOPS, ms=3)
    axes.axhline(pose.mean, color=_LOOPS, lw=1.5, label=f"mean {pose.mean:.2f}, expected {pose.dof}")
    axes.set_yscale("log")
    axes.set_ylabel("NEES")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3, fontsize="small", frameon=False)
