"""The small horizontal and vertical squares of section 4.2, which the paper recorded but did not analyse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import BLUE, VERMILLION
from slam.experiments.experiment import Conclusion, Experiment, Row, Trial, over_seeds, text
from slam.simulation import load_recipe, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SQUARES = {"horizontal_square": ("x", "y"), "vertical_square": ("x", "z")}
"""Recipe -> the axes it is drawn in."""
GAP, FIRST, SECOND = "gap from end to start", "first side", "second side"
BESIDE, SLANT = "off the plane", "largest tilt"
UNITS = {GAP: "m", FIRST: "m", SECOND: "m", BESIDE: "m", SLANT: "deg"}


def _trial(seed: int, draw: bool) -> Trial:
    figures: dict[str, float] = {}
    drawing = {}
    for name, axes in SQUARES.items():
        flight = simulate(load_recipe(name), seed)
        assert flight.truth is not None
        assert flight.attitude is not None
        place = flight.truth.w_T_b[:, :3, 3]
        k = ["xyz".index(axis) for axis in axes]
        (other,) = {0, 1, 2} - set(k)
        figures |= {
            f"{name}/{FIRST}": float(np.ptp(place[:, k[0]])),
            f"{name}/{SECOND}": float(np.ptp(place[:, k[1]])),
            f"{name}/{GAP}": float(np.linalg.norm(place[-1] - place[0])),
            f"{name}/{BESIDE}": float(np.abs(place[:, other] - place[0, other]).max()),
            f"{name}/{SLANT}": float(np.degrees(np.abs(flight.attitude.roll_pitch_yaw_rad[:, :2]).max())),
        }
        drawing[name] = place[:: 10 if draw else 50, k]
    return Trial(seed, figures, drawing)


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    rows = tuple(
        Row(
            f"{name.replace('_', ' ')}: {key}",
            unit,
            {},
            {"model paper": over_seeds(trials, f"{name}/{key}")},
        )
        for key, unit in UNITS.items()
        for name in SQUARES
    )
    horizontal, vertical = (over_seeds(trials, f"{name}/{GAP}") for name in SQUARES)
    across, up = (over_seeds(trials, f"{name}/{FIRST}").median for name in SQUARES)
    reason = (
        "the paper recorded the squares but did not analyse them. They are flown by timed commands, without "
        f"visual feedback. The horizontal one ends {text(horizontal, 'm')} from its start, "
        f"{100 * horizontal.median / across:.0f} % of its first side. The vertical one ends "
        f"{text(vertical, 'm')} from it, {100 * vertical.median / up:.0f} %."
    )
    return Conclusion(rows, "nothing to compare with", reason)


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    panels = figure.subplots(1, 2)
    for axes, (name, (across, up)) in zip(panels, SQUARES.items(), strict=True):
        for trial in reversed(trials):
            first = trial is trials[0]
            axes.plot(
                *trial.drawing[name].T, color=BLUE if first else "0.75", lw=1.6 if first else 0.8,
                label="one flight" if first else None,
            )  # fmt: skip
        start, end = trials[0].drawing[name][[0, -1]]
        axes.plot(*start, "o", color=VERMILLION, label="start")
        axes.plot(*end, "s", color=VERMILLION, mfc="white", label="end")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{across} [m]")
        axes.set_ylabel(f"{up} [m]")
        axes.set_title(name.replace("_", " "), fontsize=10)
        axes.grid(alpha=0.3)
    panels[0].legend(frameon=False, fontsize=8, loc="center")


EXPERIMENT = Experiment(
    name="squares",
    title="Small squares flown by timed commands",
    source="section 4.2",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(10.0, 4.8),
)
