"""Figures 9 and 10 of the paper as numbers, and how models reply to the same pulses of the stick.

The numbers are the real drone's speed (figure 9), the stick, and the speed of the paper's simulator USARSim
(figure 10), read off the drawings. They are measured data and no part of the project: they lie below the
folder that the environment variable ``SLAM_DATA`` names.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from slam.experiments.experiment import SeedStatistics
from slam.simulation.model import Model
from slam.simulation.motion import at_rest, simulate_motion
from slam.simulation.stick import Stick, stick_of

Array = NDArray[np.float64]

FOLDER = Path("flights") / "imav2011-figure9"
USARSIM = "usarsim_velocity.csv"
HEIGHT_M = 1.0
"""Height of the simulated flights; without ground effect it has no influence."""
LEAST_PULSE_S = 1.5
"""The paper analyses the pulses of 2, 3 and 5 s."""
SLOPE_S = (0.2, 1.0)
"""After a change of the stick the tilt has settled, and the speed is still nearly linear in time."""
STOPPED_M_S = 0.05
"""Below this speed the logarithm of the speed is noise."""
_START = {"gain": 1.0, "drag_1_s": 0.58, "attitude_time_s": 0.1, "lean": 0.5}
_LOW, _HIGH = (0.3, 0.05, 0.02, 0.0), (3.0, 3.0, 1.0, 10.0)
"""Wide bounds that the fits do not reach."""
_STEP = 1e-3
"""Relative difference of the fit's derivatives, well above the rounding of an integrated motion."""


@dataclass(frozen=True)
class Pulse:
    """One push of the stick, with the time until the next one."""

    begin_s: float
    release_s: float
    end_s: float
    sign: float
    """1 forward, -1 back."""

    @property
    def duration_s(self) -> float:
        """Duration of the push, as the paper gives it."""
        return round(self.release_s - self.begin_s, 1)


@dataclass(frozen=True)
class Figure9:
    """The curves of figures 9 and 10 at the stamps of figure 9."""

    stick: Stick
    stamps_s: Array
    """(n,) times of the real drone's speed."""
    drone_m_s: Array
    usarsim_m_s: Array
    """(n,) forward speed of the real drone and of the paper's simulator."""
    pulses: tuple[Pulse, ...]

    def of(self, duration_s: float | None = None) -> NDArray[np.bool_]:
        """(n,) samples of the pulses of one duration, or of all pulses."""
        inside = np.zeros(len(self.stamps_s), dtype=bool)
        for pulse in self.pulses:
            if duration_s is None or pulse.duration_s == duration_s:
                inside |= (self.stamps_s >= pulse.begin_s) & (self.stamps_s < pulse.end_s)
        return inside

    @property
    def durations_s(self) -> tuple[float, ...]:
        """Durations of the pulses, each once."""
        return tuple(sorted({pulse.duration_s for pulse in self.pulses}))

    def rms(self, speed_m_s: Array, samples: NDArray[np.bool_] | None = None) -> float:
        """Return the root mean square of a curve minus the real drone's, over all pulses by default."""
        now = self.of() if samples is None else samples
        return float(np.sqrt(np.mean((speed_m_s - self.drone_m_s)[now] ** 2)))


def read_figure9() -> Figure9 | None:
    """Read the figures' numbers; None where ``SLAM_DATA`` is not set or does not hold them.

    Raises ``InputError`` where they are damaged.
    """
    from slam.io.flight_folder import read_flight

    root = os.environ.get("SLAM_DATA")
    folder = Path(root or "") / FOLDER
    if not root or not (folder / USARSIM).exists():
        return None
    flight = read_flight(folder)
    command, velocity = flight.command, flight.velocity
    assert command is not None
    assert velocity is not None
    known = np.isfinite(velocity.v_m_s[:, 0])
    stamps_s, drone = velocity.stamps_s[known], velocity.v_m_s[known, 0]
    table = np.loadtxt(folder / USARSIM, delimiter=",", skiprows=1)
    usarsim = np.interp(stamps_s, table[:, 0] - flight.epoch_ns * 1e-9, table[:, 1])
    begin_s = float(command.stamps_s[0])
    stick = stick_of(command, float(command.stamps_s[-1]) - begin_s, begin_s)
    return Figure9(stick, stamps_s, drone, usarsim, pulses_of(stick, stamps_s))


def pulses_of(stick: Stick, stamps_s: Array) -> tuple[Pulse, ...]:
    """Return the pulses of a stick within recorded stamps."""
    pushes = stick.pushes_s(float(stamps_s[0]), float(stamps_s[-1]))
    ends = [begin for begin, _ in pushes[1:]] + [float(stamps_s[-1])]
    forward = [float(np.sign(stick.at(np.array([(a + b) / 2]))[0, 0])) for a, b in pushes]
    return tuple(Pulse(a, b, end, sign) for (a, b), end, sign in zip(pushes, ends, forward, strict=True))


def reply(model: Model, stick: Stick, stamps_s: Array) -> Array:
    """Return the forward speed (n,) of a model that follows the stick from a hover, without noise."""
    start = at_rest(0.0, 0.0, HEIGHT_M, 0.0)
    motion = simulate_motion(stick, model, start, begin_s=float(stamps_s[0]), end_s=float(stamps_s[-1]))
    return np.asarray(motion.at(stamps_s).h_v_m_s[:, 0])


def extended(model: Model, figure: Figure9, samples: NDArray[np.bool_]) -> Model:
    """Fit the vehicle's constants and ``active_braking`` to some samples of the real drone, by least squares.

    ``active_braking`` is the effect that ``slam criticise`` names for this flight.
    """

    def residual(values: Array) -> Array:
        curve = reply(_with(model, values), figure.stick, figure.stamps_s)
        return np.asarray((curve - figure.drone_m_s)[samples])

    fitted = least_squares(
        residual, list(_START.values()), bounds=(_LOW, _HIGH), diff_step=[_STEP] * len(_START)
    )
    return _with(model, fitted.x)


def held_out_reply(model: Model, figure: Figure9) -> Array:
    """Return the speed (n,) of extended models: each pulse by the model that the other durations were fitted
    to."""
    curve = reply(model, figure.stick, figure.stamps_s)
    for duration_s in figure.durations_s:
        own = figure.of(duration_s)
        others = extended(model, figure, figure.of() & ~own)
        curve[own] = reply(others, figure.stick, figure.stamps_s)[own]
    return curve


def _with(model: Model, values: Array) -> Model:
    named = dict(zip(_START, values.tolist(), strict=True))
    lean = named.pop("lean")
    return replace(model, vehicle=replace(model.vehicle, **named)).with_term("active_braking", lean=lean)


def accelerations(pulses: tuple[Pulse, ...], stamps_s: Array, speed_m_s: Array) -> list[float]:
    """Return the slope of the speed after each long push [m/s^2]."""
    return [p.sign * _slope(stamps_s, speed_m_s, p.begin_s) for p in _long(pulses)]


def decelerations(pulses: tuple[Pulse, ...], stamps_s: Array, speed_m_s: Array) -> list[float]:
    """Return the negative slope of the speed after each long push was released [m/s^2]."""
    return [-p.sign * _slope(stamps_s, speed_m_s, p.release_s) for p in _long(pulses)]


def decay_rates(pulses: tuple[Pulse, ...], stamps_s: Array, speed_m_s: Array) -> list[float]:
    """Return the rate at which the speed's logarithm falls after each long push was released [1/s]."""
    moving = np.abs(speed_m_s) > STOPPED_M_S
    logarithm = np.log(np.maximum(np.abs(speed_m_s), STOPPED_M_S))
    return [-_slope(stamps_s[moving], logarithm[moving], p.release_s) for p in _long(pulses)]


SLOPES: dict[str, tuple[str, Callable[[tuple[Pulse, ...], Array, Array], list[float]]]] = {
    "acceleration": ("m/s²", accelerations),
    "deceleration": ("m/s²", decelerations),
    "decay of the speed": ("1/s", decay_rates),
}
"""Quantity -> unit, and its values for the long pulses of a curve."""


def mean_of_pulses(values: list[float]) -> SeedStatistics:
    """Return the mean over the pulses with its 95 % interval, by Student's distribution."""
    known = np.array([value for value in values if np.isfinite(value)])
    if len(known) < 2:
        return SeedStatistics.of(values)
    reach = student.ppf(0.975, len(known) - 1) * known.std(ddof=1) / np.sqrt(len(known))
    mean = float(known.mean())
    return SeedStatistics(mean, mean - float(reach), mean + float(reach), len(known))


def _long(pulses: tuple[Pulse, ...]) -> list[Pulse]:
    return [pulse for pulse in pulses if pulse.duration_s >= LEAST_PULSE_S]


def _slope(stamps_s: Array, values: Array, change_s: float) -> float:
    now = (stamps_s >= change_s + SLOPE_S[0]) & (stamps_s < change_s + SLOPE_S[1])
    return float(np.polyfit(stamps_s[now], values[now], 1)[0]) if now.sum() >= 2 else float("nan")
