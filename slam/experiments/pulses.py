"""Figures 9 and 10: the response to pulses of s = 0.15, and its acceleration and deceleration.

The paper prints the curves of the real drone and of its simulator. Where their numbers are at hand
(`slam.experiments.figure9`), our models fly the same pulses and all curves are compared. Before criticism our
model is the paper's; after criticism it also has ``active_braking``. The extended model is fitted to four
durations of the pulses and judged on the fifth, for each in turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREEN, GREY, VERMILLION
from slam.experiments.experiment import (
    DRONE,
    SIMULATOR,
    Conclusion,
    Experiment,
    Row,
    SeedStatistics,
    Trial,
    text,
    verdict,
)
from slam.experiments.figure9 import (
    SLOPES,
    Figure9,
    Pulse,
    held_out_reply,
    mean_of_pulses,
    pulses_of,
    read_figure9,
    reply,
)
from slam.simulation import load_model, load_recipe
from slam.simulation.script import stick_from

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

STICK = 0.15
BEFORE, AFTER = "model paper", "extended model, held out"
GAIN = 0.5
"""Largest error of the extended model, as a share of that of the paper's simulator."""
_RATE_HZ = 60.0
_COLORS = {DRONE: VERMILLION, SIMULATOR: BLUE, BEFORE: GREY, AFTER: GREEN}
"""The real drone red and the paper's simulator blue, as in figure 10."""
_RMS = "RMS difference to the real drone"
_JUDGED = ("acceleration", "deceleration")


def _trial(seed: int, draw: bool) -> Trial:
    figure = read_figure9()
    if figure is None:
        return _alone(seed, draw)
    paper = load_model("paper")
    curves = {
        DRONE: figure.drone_m_s,
        SIMULATOR: figure.usarsim_m_s,
        BEFORE: reply(paper, figure.stick, figure.stamps_s),
        AFTER: held_out_reply(paper, figure),
    }
    figures: dict[str, float] = {}
    for name, curve in curves.items():
        figures |= _slopes(name, figure.pulses, figure.stamps_s, curve)
        if name != DRONE:
            figures[f"{name}/{_RMS}"] = figure.rms(curve)
            for duration_s in figure.durations_s:
                figures[f"{name}/{_RMS}, {duration_s:g} s"] = figure.rms(curve, figure.of(duration_s))
    return Trial(seed, figures, _drawing(figure, curves) if draw else None)


def _alone(seed: int, draw: bool) -> Trial:
    """Fly the paper's pulses with its model alone, where the figures' numbers are not at hand."""
    recipe = load_recipe(f"pulses_{round(100 * STICK):03d}")
    stick = stick_from(recipe.maneuver)
    stamps_s = np.arange(0.0, stick.duration_s, 1.0 / _RATE_HZ)
    curve = reply(recipe.model, stick, stamps_s)
    drawing = {
        "stick": (stick.stamps_s, stick.values[:, 0]),
        "stamps_s": stamps_s,
        "curves": {BEFORE: curve},
        "longest_s": (float(stamps_s[0]), float(stamps_s[-1])),
    }
    figures = _slopes(BEFORE, pulses_of(stick, stamps_s), stamps_s, curve)
    return Trial(seed, figures, drawing if draw else None)


def _slopes(name: str, pulses: tuple[Pulse, ...], stamps_s: Array, curve: Array) -> dict[str, float]:
    figures: dict[str, float] = {}
    for kind, (_, values) in SLOPES.items():
        mean = mean_of_pulses(values(pulses, stamps_s, curve))
        figures |= {
            f"{name}/{kind}": mean.median,
            f"{name}/{kind}/lower95": mean.lower95,
            f"{name}/{kind}/upper95": mean.upper95,
            f"{name}/{kind}/pulses": float(mean.seeds),
        }
    return figures


def _drawing(figure: Figure9, curves: dict[str, Array]) -> dict[str, Any]:
    longest = max(figure.pulses, key=lambda pulse: pulse.duration_s)
    return {
        "stick": (figure.stick.stamps_s, figure.stick.values[:, 0]),
        "stamps_s": figure.stamps_s,
        "curves": curves,
        "longest_s": (longest.begin_s - 1.0, figure.pulses[-1].end_s),
    }


def _mean(trial: Trial, name: str, kind: str) -> SeedStatistics:
    mean, low, high = (trial.figures[f"{name}/{kind}{end}"] for end in ("", "/lower95", "/upper95"))
    return SeedStatistics(mean, low, high, int(trial.figures[f"{name}/{kind}/pulses"]))


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    trial = trials[0]
    if f"{DRONE}/acceleration" not in trial.figures:
        return _without_data(trial)
    theirs, before, after = (trial.figures[f"{name}/{_RMS}"] for name in (SIMULATOR, BEFORE, AFTER))
    real = after <= GAIN * theirs and _slopes_agree(trial, DRONE, AFTER)
    simulated = _slopes_agree(trial, SIMULATOR, BEFORE)
    return Conclusion(
        _rows(trial),
        verdict(real and simulated, partly=real or simulated),
        _reason(trial, theirs, before, after),
    )


def _slopes_agree(trial: Trial, theirs: str, ours: str) -> bool:
    """Whether the intervals of both slopes overlap."""
    pairs = [(_mean(trial, theirs, kind), _mean(trial, ours, kind)) for kind in _JUDGED]
    return all(a.lower95 <= b.upper95 and b.lower95 <= a.upper95 for a, b in pairs)


def _rows(trial: Trial) -> tuple[Row, ...]:
    errors = [key.partition("/")[2] for key in trial.figures if key.startswith(f"{SIMULATOR}/{_RMS}")]
    rows = [
        Row(
            key.replace(f"{_RMS}, ", "the same, pulses of "),
            "m/s",
            {SIMULATOR: trial.figures[f"{SIMULATOR}/{key}"]},
            {name: SeedStatistics.of([trial.figures[f"{name}/{key}"]]) for name in (BEFORE, AFTER)},
        )
        for key in errors
    ]
    slopes = [
        Row(
            f"{kind}, mean of the six long pulses",
            unit,
            {name: _mean(trial, name, kind) for name in (DRONE, SIMULATOR)},
            {name: _mean(trial, name, kind) for name in (BEFORE, AFTER)},
        )
        for kind, (unit, _) in SLOPES.items()
    ]
    return (rows[0], *slopes, *rows[1:])


def _reason(trial: Trial, theirs: float, before: float, after: float) -> str:
    def both(name: str) -> str:
        up, down = (text(_mean(trial, name, kind)) for kind in _JUDGED)
        return f"{up} m/s² up and {down} down"

    up, down = (_mean(trial, SIMULATOR, kind).median / _mean(trial, DRONE, kind).median for kind in _JUDGED)
    return (
        f"by figure 9 the real drone's speed changes with {both(DRONE)}, and by figure 10 USARSim's with "
        f"{both(SIMULATOR)}. The paper's text calls the acceleration nearly the same and the braking "
        f"slightly slower; by its own curves USARSim has {up:.2f} and {down:.2f} times the drone's slopes. "
        f"USARSim misses the real drone by {theirs:.3f} m/s RMS, our model with the paper's constants "
        f"by {before:.3f}. From those constants figure 10 does not follow: the model speeds up and slows "
        "down less. With active_braking, which criticism names, and refitted constants our model misses "
        f"the real drone by {after:.3f}, on pulses that it was not fitted to: {after / theirs:.2f} times "
        "USARSim's error. Brackets are 95 % intervals of the mean over six pulses."
    )


def _without_data(trial: Trial) -> Conclusion:
    rows = tuple(
        Row(f"{kind}, mean of the six long pulses", unit, {}, {BEFORE: _mean(trial, BEFORE, kind)})
        for kind, (unit, _) in SLOPES.items()
    )
    return Conclusion(
        rows,
        "nothing to compare with",
        "the numbers of figures 9 and 10 are measured data and no part of the project. To compare them, set "
        "the environment variable SLAM_DATA to the folder that holds flights/imav2011-figure9. The rows show "
        "our model alone.",
    )


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    made = trials[0].drawing
    top, middle, bottom = figure.subplots(3, 1)
    stamps_s, curves = made["stamps_s"], made["curves"]
    first = next(iter(curves))
    top.step(*made["stick"], where="post", color=VERMILLION, lw=1.2, label="control signal s")
    top.plot(stamps_s, curves[first], color=BLUE, lw=0.9, label=f"forward speed [m/s]: {first}")
    top.set_title(f"Response to pulses of s = {STICK}, in the form of figure 9", fontsize=10)
    top.set_ylabel("s, and speed [m/s]")
    for axes, span_s, title in (
        (middle, (stamps_s[0], stamps_s[-1]), "All curves on the same pulses, in the form of figure 10"),
        (bottom, made["longest_s"], "The last pulses enlarged"),
    ):
        now = (stamps_s >= span_s[0]) & (stamps_s <= span_s[1])
        for name, curve in curves.items():
            width = 2.4 if name == DRONE else 1.3
            axes.plot(stamps_s[now], curve[now], color=_COLORS[name], lw=width, label=name)
        axes.set_title(title, fontsize=10)
        axes.set_ylabel("forward speed [m/s]")
    for axes in (top, middle):
        axes.legend(frameon=False, fontsize=8, loc="upper left", ncols=2)
    for axes in (top, middle, bottom):
        axes.grid(alpha=0.3)
        axes.set_xlabel("time [s]")
    # One range of both figures, with room for the legend.
    low, high = middle.get_ylim()
    for axes in (top, middle):
        axes.set_xlim(stamps_s[0], stamps_s[-1])
        axes.set_ylim(low, 1.5 * high)


EXPERIMENT = Experiment(
    name="pulses",
    title="Response to pulses: speeding up and slowing down",
    source="section 4.2.2, figures 9 and 10",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(10.0, 9.5),
    random=False,
)
