"""Consistency of the paper's own numbers with each other. Nothing is flown."""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

import numpy as np

from slam.evaluation.paper_values import P_THETA, PITCH_DEG, SPEED_A_DEGREE, SPEED_M_S, STICKS
from slam.experiments.experiment import PAPER, Conclusion, Experiment, Row, SeedStatistics, Trial, verdict
from slam.experiments.paper_checks import OUTLIER, checks, line_through_table_5

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _trial(seed: int, draw: bool) -> Trial:
    return Trial(seed, {check.name: check.recomputed for check in checks()})


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    found = checks()
    rows = tuple(
        Row(
            check.name,
            check.unit,
            {PAPER: check.paper},
            {"recomputed": SeedStatistics.of([check.recomputed])},
        )
        for check in found
    )
    failing = [check for check in found if not check.holds]
    explained = " ".join(f"({k}) {check.name}: {check.explanation}." for k, check in enumerate(failing, 1))
    reason = (
        f"{len(found) - len(failing)} of {len(found)} numbers follow from the paper's others. The rest do "
        f"not. {explained}"
    )
    return Conclusion(rows, verdict(not failing, partly=len(failing) < len(found)), reason)


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
    pitch, speed = [PITCH_DEG[s] for s in STICKS], [SPEED_M_S[s] for s in STICKS]
    tilt = np.linspace(0, 8.5, 2)
    left.plot(pitch, speed, "o", color="tab:red", label="table 5")
    for slope, label, style in (
        (SPEED_A_DEGREE, "equation 4", "-"),
        (line_through_table_5(), "least squares", "--"),
        (line_through_table_5(OUTLIER), "without s = 0.10", ":"),
        (radians(1) / P_THETA, "P_theta", "-."),
    ):
        left.plot(tilt, slope * tilt, style, lw=1.2, label=f"{label}: {slope:.4f}")
    left.annotate(
        "s = 0.10",
        (PITCH_DEG[OUTLIER], SPEED_M_S[OUTLIER]),
        xytext=(6, -12),
        textcoords="offset points",
    )
    left.set_xlabel("pitch [deg]")
    left.set_ylabel("speed [m/s]")
    left.legend(frameon=False, fontsize=8)
    found = checks()
    ratio = [check.recomputed / check.paper for check in found]
    for k, check in enumerate(found):
        right.plot(ratio[k], k, "o", color="tab:blue" if check.holds else "tab:red")
    right.axvline(1, color="0.6", lw=1)
    right.set_xscale("log")
    right.set_xticks([0.02, 0.1, 0.5, 1, 2, 4], ["0.02", "0.1", "0.5", "1", "2", "4"])
    right.set_yticks(range(len(found)), [check.name for check in found], fontsize=7)
    right.invert_yaxis()
    right.set_xlabel("recomputed over the paper's (red: does not follow)")


EXPERIMENT = Experiment(
    name="arithmetic",
    title="What the paper's own numbers say",
    source="tables 1, 2 and 5, sections 3.1 and 4",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(13.0, 5.2),
    random=False,
)
