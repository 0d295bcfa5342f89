"""The picture of ``slam estimate``: where the vehicle was, how well that is known, and how its readings
fitted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.estimate import Estimate
from slam.report.pictures import BLUE, GREY, ORANGE, VERMILLION, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from backend.ekf.results import Channel, Track

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
_WIDEST = 6.0
"""Innovations beyond so many standard deviations are drawn at the edge."""


def estimate_picture(estimate: Estimate, track: Track) -> bytes:
    """Top view with 2-sigma ellipses, height with its band, and whitened innovations by channel, as PNG."""
    from matplotlib.figure import Figure

    shown = [name for name in _SHOWN if name in track.channels]
    figure = Figure(figsize=(13, max(6.0, 1.45 * (len(shown) + 2))), dpi=110, layout="constrained")
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=(1, 1.1)))
    _top_view(left.subplots(), estimate)
    panels = right.subplots(len(shown) + 1, 1, sharex=True, squeeze=False)[:, 0]
    begin_s = float(estimate.stamps_s[0])
    _height(panels[0], estimate)
    for axes, name in zip(panels[1:], shown, strict=True):
        _innovations(axes, name, track.channels[name], begin_s)
    panels[-1].set_xlabel("time since the start [s]")
    right.align_ylabels(panels)
    figure.suptitle(_title(estimate), fontsize="medium")
    return png(figure)


def _title(estimate: Estimate) -> str:
    return estimate.name.replace("$", r"\$")


def _top_view(axes: Axes, estimate: Estimate) -> None:
    for poses, color, width, label in (
        (estimate.chain_w_T_b, GREY, 0.9, estimate.ways[0]),
        (estimate.odometry_w_T_b, ORANGE, 0.9, estimate.ways[1]),
        (estimate.w_T_b, BLUE, 1.6, estimate.ways[2]),
    ):
        if np.isfinite(poses[:, 0, 3]).any():
            axes.plot(poses[:, 0, 3], poses[:, 1, 3], color=color, lw=width, label=label)
    start = estimate.w_T_b[0, :2, 3]
    axes.plot(*start, "o", color=BLUE, mfc="white", ms=6, label="start")
    picked = np.unique(np.linspace(0, len(estimate.w_T_b) - 1, _ELLIPSES).astype(int))
    R = estimate.w_T_b[picked, :3, :3]
    P = (R @ estimate.covariances[picked, 3:, 3:] @ R.transpose(0, 2, 1))[:, :2, :2]
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 60))
    unit = np.stack([circle.real, circle.imag])
    for number, (k, block) in enumerate(zip(picked, P, strict=True)):
        variance, axis = np.linalg.eigh(block)
        ring = estimate.w_T_b[k, :2, 3, None] + 2 * (axis * np.sqrt(np.maximum(variance, 0))) @ unit
        axes.plot(*ring, color=BLUE, lw=0.7, alpha=0.45, label="2σ of the place" if number == 0 else None)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]" if estimate.origin else "x [m]")
    axes.set_ylabel("north [m]" if estimate.origin else "y [m]")
    axes.grid(color="#e4e7eb", lw=0.6)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, fontsize="small", frameon=False)


def _height(axes: Axes, estimate: Estimate) -> None:
    t, z = estimate.stamps_s - estimate.stamps_s[0], estimate.w_T_b[:, 2, 3]
    up = estimate.w_T_b[:, 2, :3]
    sigma = np.sqrt(np.maximum(np.einsum("na,nab,nb->n", up, estimate.covariances[:, 3:, 3:], up), 0))
    axes.fill_between(t, z - 2 * sigma, z + 2 * sigma, color=BLUE, alpha=0.2, lw=0)
    axes.plot(t, z, color=BLUE, lw=1.2)
    axes.set_ylabel("height [m]", fontsize="small")
    axes.set_title("height with 2σ; below, reading minus what was foreseen, in σ", fontsize="small")


def _innovations(axes: Axes, name: str, channel: Channel, begin_s: float) -> None:
    whitened = np.clip(channel.innovation / channel.std, -_WIDEST, _WIDEST)
    every = max(1, len(whitened) // _MOST_DOTS)
    labels = _LABELS.get(name, ("",))
    for k, (label, color) in enumerate(zip(labels, _COLORS, strict=False)):
        if np.isfinite(whitened[:, k]).any():
            axes.plot(
                channel.stamps_s[::every] - begin_s,
                whitened[::every, k],
                ".",
                color=color,
                ms=1.5,
                label=label,
            )
    axes.axhspan(-2, 2, color="black", alpha=0.06, lw=0)
    axes.set_ylim(-_WIDEST - 0.3, _WIDEST + 0.3)
    axes.set_ylabel(name, fontsize="small")
    if len(labels) > 1:
        axes.legend(loc="upper right", ncols=3, fontsize="x-small", frameon=False, markerscale=5)
