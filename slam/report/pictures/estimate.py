"""Figure of ``slam estimate``: trajectories, their uncertainty, and whitened innovations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.plot_style import (
    BLUE,
    ORANGE,
    PALE_GREY,
    VERMILLION,
    escape_math,
    grid,
    ground_labels,
    legend_below,
    png,
    steady_ticks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from backend.ekf.results import InstrumentInnovations, Track

Array = NDArray[np.float64]

_SHOWN = ("attitude", "range", "velocity", "position", "barometer", "accelerometer", "gyro")
_LABELS = {
    "attitude": ("roll", "pitch", "yaw"),
    "velocity": ("forward", "left"),
    "position": ("east", "north", "up"),
    "accelerometer": ("x", "y", "z"),
    "gyro": ("x", "y", "z"),
}
_COLORS = (BLUE, ORANGE, VERMILLION)
_MOST_DOTS = 3000
_ELLIPSES = 25
_NARROWEST, _WIDEST = 3.0, 6.0
"""Standard deviations at the edges of the innovation panels; larger values are drawn at the edge."""
_WIDTH_IN, _PANEL_IN = 13.0, 1.45
_VIEW_IN = 5.4
"""Width of the top view; its height follows the trajectory's shape, within limits."""
_LEAST_VIEW_IN, _MOST_VIEW_IN = 3.0, 7.5


def estimate_picture(estimate: Estimate, track: Track) -> bytes:
    """Draw the figure as PNG: top view, height, difference of the trajectories with 2-sigma bands, and
    whitened innovations by channel."""
    from matplotlib.figure import Figure

    shown = [name for name in _SHOWN if name in track.channels]
    size_m = _size(estimate)
    view_in = float(np.clip(_VIEW_IN * size_m[1] / size_m[0], _LEAST_VIEW_IN, _MOST_VIEW_IN))
    beside_in = max(1.6, (_PANEL_IN * len(shown) - view_in) / 2)
    height_in = view_in + 2 * beside_in + 1.2
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=110, layout="constrained")
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=(1, 1.1)))
    view, height, between = left.subplots(3, 1, height_ratios=(view_in, beside_in, beside_in))
    _top_view(view, estimate, float(size_m.max()))
    _height(height, estimate)
    _between_ways(between, estimate)
    height.sharex(between)
    panels = right.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, shown, strict=False):
        _innovations(axes, name, track.channels[name], float(estimate.stamps_s[0]))
    panels[0].set_title("reading minus prediction, in σ; larger ones are drawn at the edge", fontsize="small")
    for axes in (between, panels[-1]):
        axes.set_xlabel("time since the start [s]")
        axes.set_xlim(0.0, float(estimate.stamps_s[-1] - estimate.stamps_s[0]))
    right.align_ylabels(panels)
    figure.suptitle(escape_math(estimate.name), fontsize="medium")
    return png(figure)


def _ways(estimate: Estimate) -> Iterator[tuple[Array, str, float, str]]:
    """Positions, colour, line width and name of each available trajectory, the widest line first.

    A line that covers another leaves it visible on both sides.
    """
    for poses, color, width, label in (
        (estimate.chain_w_T_b, PALE_GREY, 4.5, estimate.trajectory_names[0]),
        (estimate.odometry_w_T_b, ORANGE, 2.4, estimate.trajectory_names[1]),
        (estimate.w_T_b, BLUE, 1.0, estimate.trajectory_names[2]),
    ):
        if np.isfinite(poses[:, 0, 3]).any():
            yield poses[:, :3, 3], color, width, label


def _size(estimate: Estimate) -> Array:
    """(2,) extent of all trajectories together along x and y, in metres; never zero."""
    placed = np.concatenate([position[:, :2] for position, *_ in _ways(estimate)])
    return np.asarray(np.maximum(np.nanmax(placed, axis=0) - np.nanmin(placed, axis=0), 0.01))


def _top_view(axes: Axes, estimate: Estimate, across_m: float) -> None:
    for position, color, width, label in _ways(estimate):
        axes.plot(position[:, 0], position[:, 1], color=color, lw=width, label=label)
    axes.plot(*estimate.w_T_b[0, :2, 3], "o", color=BLUE, mfc="white", ms=6, label="start", zorder=3)
    _ellipses(axes, estimate, across_m)
    axes.set_aspect("equal", adjustable="datalim")
    x, y = ground_labels(on_earth=estimate.origin is not None)
    axes.set(xlabel=x, ylabel=y)
    grid(axes)
    legend_below(axes)


def _ellipses(axes: Axes, estimate: Estimate, across_m: float) -> None:
    """Ellipses that leave the trajectories visible; `_between_ways` shows the size of the others."""
    picked = np.unique(np.linspace(0, len(estimate.w_T_b) - 1, _ELLIPSES).astype(int))
    variances, turns = np.linalg.eigh(_over_floor(estimate)[picked])
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 60))
    unit, label = np.stack([circle.real, circle.imag]), "2σ of the position"
    for k, variance, turn in zip(picked, variances, turns, strict=True):
        reach_m = 2 * np.sqrt(np.maximum(variance, 0))
        if reach_m[-1] < across_m / 4:
            ring = estimate.w_T_b[k, :2, 3, None] + (turn * reach_m) @ unit
            axes.plot(*ring, color=BLUE, lw=0.7, alpha=0.45, label=label)
            label = ""


def _over_floor(estimate: Estimate) -> Array:
    """Covariances (n, 2, 2) of the positions along x and y of the world."""
    R = estimate.w_T_b[:, :3, :3]
    P: Array = (R @ estimate.covariances[:, 3:, 3:] @ R.transpose(0, 2, 1))[:, :2, :2]
    return P


def _height(axes: Axes, estimate: Estimate) -> None:
    t, z = estimate.stamps_s - estimate.stamps_s[0], estimate.w_T_b[:, 2, 3]
    up = estimate.w_T_b[:, 2, :3]
    sigma = np.sqrt(np.maximum(np.einsum("na,nab,nb->n", up, estimate.covariances[:, 3:, 3:], up), 0))
    axes.fill_between(t, z - 2 * sigma, z + 2 * sigma, color=BLUE, alpha=0.2, lw=0)
    axes.plot(t, z, color=BLUE, lw=1.2)
    axes.set_ylabel("height [m]", fontsize="small")
    axes.set_title("height with 2σ", fontsize="small")
    axes.tick_params(labelbottom=False)


def _between_ways(axes: Axes, estimate: Estimate) -> None:
    """Draw the horizontal distance of the other trajectories from the last one."""
    t = estimate.stamps_s - estimate.stamps_s[0]
    known_m = 2 * np.sqrt(np.maximum(np.linalg.eigvalsh(_over_floor(estimate))[:, -1], 0))
    axes.fill_between(t, 0, known_m, color=BLUE, alpha=0.2, lw=0, label="2σ of the position")
    *others, (best, _, _, name) = _ways(estimate)
    for position, color, width, label in others:
        off = np.linalg.norm((position - best)[:, :2], axis=1)
        axes.plot(t, off, color=color, lw=width / 2, label=label)
    axes.set_ylim(0.0, None)
    axes.set_ylabel("distance [m]", fontsize="small")
    axes.set_title(f"horizontal distance of the other trajectories from the {name} one", fontsize="small")
    axes.legend(loc="upper left", fontsize="x-small", frameon=False)


def _innovations(axes: Axes, name: str, channel: InstrumentInnovations, begin_s: float) -> None:
    """Draw dots of all components in order of time, so that none always covers another."""
    every = max(1, len(channel.stamps_s) // _MOST_DOTS)
    labels = _LABELS.get(name, ("",))
    whitened = (channel.innovation / channel.std)[::every, : len(labels)]
    sizes = np.abs(whitened[np.isfinite(whitened)])
    # The limits exclude the largest half percent.
    edge = float(np.clip(1.2 * np.quantile(sizes, 0.995) if len(sizes) else 0.0, _NARROWEST, _WIDEST))
    stamps_s = np.repeat(channel.stamps_s[::every] - begin_s, whitened.shape[1])
    colors = np.tile(_COLORS[: whitened.shape[1]], len(whitened))
    axes.scatter(stamps_s, np.clip(whitened, -edge, edge).ravel(), s=1.5, c=colors, linewidths=0)
    axes.axhspan(-2, 2, color="black", alpha=0.06, lw=0)
    axes.set_ylim(-1.05 * edge, 1.05 * edge)
    axes.set_ylabel(name, fontsize="small")
    steady_ticks(axes)
    if len(labels) > 1:
        for label, color, column in zip(labels, _COLORS, whitened.T, strict=False):
            if np.isfinite(column).any():
                axes.plot([], [], ".", color=color, ms=8, label=label)
        axes.legend(loc="upper right", ncols=3, fontsize="x-small", frameon=False)
