"""Figures 9 and 10: the response to pulses of s = 0.15, and its acceleration and deceleration.

In the paper's simulator drag alone slows the vehicle down. The paper states that the real drone also brakes
by its optical flow (section 4.2.2). Its curves of the real drone are pictures without figures. Therefore the
same vehicle with the term ``active_braking`` represents a drone that does what the paper says.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.experiments.experiment import (
    Conclusion,
    Experiment,
    Row,
    SeedStatistics,
    Trial,
    column,
    over_seeds,
    text,
    verdict,
)
from slam.simulation import load_recipe, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slam.core.flight import Flight

Array = NDArray[np.float64]

STICK = 0.15
BRAKING_1_S = 0.6
"""Braking rate of the drone that brakes; in the middle of the usual 0.2 to 2."""
LONG_PULSES_S = ((36.2, 38.2), (46.2, 48.2), (56.2, 59.2), (67.2, 70.2), (78.2, 83.2), (91.2, 96.2))
"""Begin and end of the pulses of 2, 3 and 5 s, whose starts the paper analysed."""
SLOPE_S = (0.2, 1.0)
"""After a change of the stick the tilt has settled, and the speed is still nearly linear in time."""
_SAME = 0.05
"""Slopes that differ by less are "nearly the same"."""
REACHED = 0.9
"""Share of the commanded pitch that counts as reached, within the noise of its reading."""
SIMULATED, BRAKING = "paper's simulator", "a drone that brakes"
ACCELERATION, DECELERATION, DELAY = "acceleration", "deceleration", "time to the commanded pitch"


def _trial(seed: int, draw: bool) -> Trial:
    figures: dict[str, float] = {}
    drawing = {}
    for name, terms in ((SIMULATED, {}), (BRAKING, {"active_braking": {"k_b": BRAKING_1_S}})):
        recipe = load_recipe(f"pulses_{round(100 * STICK):03d}")
        flight = simulate(replace(recipe, model=replace(recipe.model, terms=terms)), seed)
        up, down, delay = _slopes(flight)
        figures |= {f"{name}/{ACCELERATION}": up, f"{name}/{DECELERATION}": down, f"{name}/{DELAY}": delay}
        if draw:
            drawing[name] = _curves(flight)
    for kind in (ACCELERATION, DECELERATION):
        figures[f"ratio/{kind}"] = figures[f"{SIMULATED}/{kind}"] / figures[f"{BRAKING}/{kind}"]
    return Trial(seed, figures, drawing)


def _slopes(flight: Flight) -> tuple[float, float, float]:
    """Mean slopes of the speed [m/s^2] after the stick is pushed and after it is released, and mean time [s]
    from the push until the commanded pitch is reached."""
    velocity, attitude = flight.velocity, flight.attitude
    assert velocity is not None
    assert attitude is not None
    up, down, delay = [], [], []
    for sign, (begin, end) in zip((1, -1) * 3, LONG_PULSES_S, strict=True):
        up.append(sign * _slope(velocity.stamps_s, velocity.v_m_s[:, 0], begin))
        down.append(-sign * _slope(velocity.stamps_s, velocity.v_m_s[:, 0], end))
        now = (attitude.stamps_s >= begin) & (attitude.stamps_s < end)
        asked = STICK * flight.command.max_tilt_rad if flight.command is not None else np.nan
        there = sign * attitude.roll_pitch_yaw_rad[now, 1] >= REACHED * asked
        delay.append(float(attitude.stamps_s[now][there][0] - begin) if there.any() else np.nan)
    return float(np.mean(up)), float(np.mean(down)), float(np.nanmean(delay))


def _slope(stamps_s: Array, speed: Array, change_s: float) -> float:
    now = (stamps_s >= change_s + SLOPE_S[0]) & (stamps_s < change_s + SLOPE_S[1])
    return float(np.polyfit(stamps_s[now], speed[now], 1)[0])


def _curves(flight: Flight) -> dict[str, tuple[Array, Array]]:
    velocity, attitude, command = flight.velocity, flight.attitude, flight.command
    assert velocity is not None
    assert attitude is not None
    assert command is not None
    return {
        "stick": (command.stamps_s, command.stick[:, 0]),
        "speed": (velocity.stamps_s[::4], velocity.v_m_s[::4, 0]),
        "pitch": (attitude.stamps_s[::4], np.degrees(attitude.roll_pitch_yaw_rad[::4, 1])),
    }


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    up, down = (SeedStatistics.of(column(trials, f"ratio/{kind}")) for kind in (ACCELERATION, DECELERATION))
    delay = over_seeds(trials, f"{SIMULATED}/{DELAY}")
    reason = (
        "the reference is a drone that brakes by its optical flow (a rate of "
        f"{BRAKING_1_S} 1/s, assumed). The simulated drone speeds up with {text(up)} times its slope, "
        f"and slows down with {text(down)} times. The commanded pitch is reached after "
        f"{1e3 * delay.median:.0f} ms. The paper's explanation thus gives what its figure 10 shows. The "
        "figure does not show how hard the real drone brakes."
    )
    rows = tuple(
        Row(kind, unit, {}, {name: over_seeds(trials, f"{name}/{kind}") for name in (SIMULATED, BRAKING)})
        for kind, unit in ((ACCELERATION, "m/s²"), (DECELERATION, "m/s²"), (DELAY, "s"))
    )
    first = Row("slowing down, slope over the braking drone's", "1", {}, {SIMULATED: down})
    second = Row("speeding up, slope over the braking drone's", "1", {}, {SIMULATED: up})
    alike = abs(up.median - 1) < _SAME and down.median < 1 - _SAME
    # It agrees in part at best: the paper shows the real drone as a curve without figures.
    return Conclusion((first, second, *rows), verdict(False, partly=alike), reason)


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    top, middle, bottom = figure.subplots(3, 1)
    curves = trials[0].drawing
    stick, speed = curves[SIMULATED]["stick"], curves[SIMULATED]["speed"]
    top.plot(*speed, color="tab:blue", lw=1, label="speed [m/s]")
    top.step(
        stick[0], 10 * stick[1], where="post", color="tab:red", lw=1.2, label="control signal s, times 10"
    )
    top.set_title(f"Response to pulses of s = {STICK} (as figure 9; simulated)", fontsize=10)
    for axes, kind, unit in ((middle, "speed", "m/s"), (bottom, "pitch", "deg")):
        axes.plot(
            *curves[BRAKING][kind], color="tab:red", lw=0.9, label=f"a drone that brakes, {BRAKING_1_S} 1/s"
        )
        axes.plot(*curves[SIMULATED][kind], color="tab:blue", lw=0.9, label="the paper's simulator")
        axes.set_xlim(77, 102)
        axes.set_ylabel(f"{kind} [{unit}]")
    middle.set_title("The pulse of 5 s and its counter-pulse (as figure 10; both simulated)", fontsize=10)
    bottom.set_xlabel("time [s]")
    for axes in (top, middle):
        axes.legend(frameon=False, fontsize=8, loc="upper right")


EXPERIMENT = Experiment(
    name="pulses",
    title="Response to pulses: speeding up and slowing down",
    source="section 4.2.2, figures 9 and 10",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(10.0, 8.5),
)
