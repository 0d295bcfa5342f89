"""Effects: each term of the catalogue as perturbations, or as a change of the process noise; and patterns.

The equations are the simulator's. This file states which of their parameters are tried, the differences for
their derivatives, and the meaning of a fitted value in the catalogue's units. Residual patterns, which no
term makes, inject signals (place, speed, tilt, stick, time) into each channel of the instruments, and into
forces and targets of the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from slam.core.arrays import Array
from slam.criticism.camera.lens import PAIRS, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS, VARIANCE_PATTERNS
from slam.criticism.kalman.filter_parameters import SQUARES, FilterParameters, slot
from slam.criticism.kalman.kernel_inputs import FORCES, Perturbation, Signal
from slam.criticism.kalman.readings import ATTITUDE, CHANNELS, VELOCITY, channels_of
from slam.criticism.kalman.record import Record
from slam.criticism.search.fitted_parameters import AT, NUISANCES, FittedParameter, fitted_parameter
from slam.criticism.search.thresholds import parameter_cost
from slam.data_quality.commands import LEAST_STICK, holds_heading
from slam.simulation.dynamics import GAIN, MAX_TILT, TILT_LIMIT, TURN
from slam.simulation.terms import CATALOGUE, Term

PLAUSIBLE = 3.0
"""Greatest distance of a possible value from neutral, in greatest usual distances."""


@dataclass(frozen=True)
class Effect:
    """A term of the catalogue that the streams at hand can show, or another effect that is tried as well."""

    name: str
    perturbations: tuple[Perturbation, ...] = ()
    changes: tuple[FittedParameter, ...] = ()
    parameters: tuple[str, ...] = ()
    """Parameters of the term, one for each column."""
    positive: bool = False
    """Whether the size is never negative: a fit below 0 counts as none."""
    relaxes: tuple[str, ...] = ()
    """Nuisances that may leave their healthy range instead."""
    tolerance: float = 0.0
    """Size below which there is none where integrals of instruments are compared; 0 for the filter."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its columns."""
        return (*(d.name for d in self.perturbations), *(c.name for c in self.changes), *self.relaxes)

    @property
    def cost(self) -> float:
        """Cost of its parameters in nats."""
        return parameter_cost(len(self.columns))

    @property
    def label(self) -> str:
        """Name, with the first column: a term may be tried in several ways."""
        return f"{self.name}:{self.columns[0]}"

    @property
    def is_term(self) -> bool:
        """Whether it is a term of the catalogue."""
        return self.name in CATALOGUE

    @property
    def is_profiled(self) -> bool:
        """Whether it is tried at the values of a grid: it has a size only once it is fitted."""
        return AT in self.columns[0] and not self.changes

    @property
    def is_saturation(self) -> bool:
        """Whether it saturates: its slope at the limit does not predict the effect of removing the limit."""
        return self.is_term and CATALOGUE[self.name].parameters[0].is_limit

    @property
    def free(self) -> Effect:
        """The effect as tried about parameters that include it: a value of a grid becomes free."""
        if not self.is_profiled:
            return self
        return replace(
            self, perturbations=(fitted_parameter(f"{self.name}.{self.parameters[0]}").perturbation,)
        )

    def in_catalogue_units(self, column: int, size: float, parameters: FilterParameters) -> float:
        """Return a column's size in the catalogue's units."""
        return fitted_parameter(self.columns[column]).in_catalogue_units(float(size), parameters)

    def size_in(self, parameters: FilterParameters) -> Array:
        """Return (columns,) its size in filter parameters."""
        return np.array([fitted_parameter(column).size_in(parameters) for column in self.columns])

    def without(self, parameters: FilterParameters) -> FilterParameters:
        """Return the parameters without it; a nuisance beyond its range keeps its value."""
        for column in (*(fitted_parameter(d.name) for d in self.free.perturbations), *self.changes):
            parameters = column.without_effect(parameters)
        return parameters

    def implausible_column(self, parameters: FilterParameters, size: Array, reach: Array) -> int | None:
        """Return the first column whose size lies far beyond its plausible range, by more than ``reach``."""
        for k, name in enumerate(self.parameters if self.perturbations else ()):
            usual = CATALOGUE[self.name].parameter(name)
            far = PLAUSIBLE * max(abs(usual.high - usual.neutral), abs(usual.low - usual.neutral))
            least, most = max(usual.neutral - far, usual.least), min(usual.neutral + far, usual.most)
            values = [self.in_catalogue_units(k, size[k] + side * reach[k], parameters) for side in (-1, 1)]
            if max(values) < least or min(values) > most:
                return k
        return None

    def repeats(self, other: Effect) -> bool:
        """Whether it is the same quantity, even if tried in another way, such as gusts of another time."""
        return (self.name, self.parameters) == (other.name, other.parameters)


def is_variance(perturbation: Perturbation) -> bool:
    """Whether a size is a square or a variance: not negative, and naturally different between segments."""
    in_camera = perturbation.kind == "camera" and perturbation.entry in SQUARES
    return in_camera or perturbation.name in VARIANCE_PATTERNS


LATE = {"attitude late": (ATTITUDE, "attitude.delay_s"), "velocity late": (VELOCITY, "velocity.delay_s")}
"""Delays that belong to no term but have a parameter in the equations: kind of events, and the parameter."""
PICTURES = ("camera", "frames")
"""Streams that only pictures show."""

TILT_LIMITS = (0.9, 0.7, 0.5, 0.3)
"""Values of a limit that are tried, as shares of the greatest tilt demanded."""
LATENCIES_S = (0.015, 0.04, 0.08, 0.15)
GUST_TIMES_S = (0.7, 2.5)
LOWEST_TILT_RAD = 0.03


def effects_for(records: Sequence[Record], parameters: FilterParameters) -> list[Effect]:
    """Return every term that is screened, each with its columns, and delayed readings.

    For an out-of-model vehicle delayed readings and pure process noise are left out.
    """
    seen = any(r.matches is not None for r in records)
    found = [e for term in CATALOGUE.values() if seen or term.stream not in PICTURES for e in _plain(term)]
    if parameters.latency_s == 0.0:
        found += _at_values("control_latency.T", LATENCIES_S, 0.0)
    turns = any((np.abs(record.stick.values[:, TURN]) >= LEAST_STICK).any() for record in records)
    if any(holds_heading(record.stick) for record in records) or not turns:
        # A vehicle that was never commanded to turn shows slower yaw by its process noise alone.
        found = [effect for effect in found if effect.name != "yaw_drag"]
    found.append(Effect("attitude_lag", (), (), ("tau",), False, ("vehicle.attitude_time_s",)))
    reach = parameters.dynamics[MAX_TILT] * parameters.dynamics[GAIN]
    asked = reach * max(float(np.abs(r.stick.values[:, :2]).max()) for r in records)
    now = parameters.dynamics[TILT_LIMIT]
    if asked >= LOWEST_TILT_RAD and now >= pi / 2:
        found += _at_values("tilt_limit.limit", [share * asked for share in TILT_LIMITS], now)
    if not parameters.out_of_model:
        found += [_variance("gusts", f"gusts{AT}{tau:g}") for tau in GUST_TIMES_S]
        found += delayed_readings(records)
        found.append(_variance("timestamp_jitter", "timestamp_jitter.var"))
    return found


def delayed_readings(records: Sequence[Record]) -> list[Effect]:
    """Return delays of instruments, where no term of the catalogue stands for them."""
    return [
        Effect(name, (fitted_parameter(parameter).perturbation,))
        for name, (kind, parameter) in LATE.items()
        if any(record.has(channel) for record in records for channel in channels_of(kind))
    ]


def relaxed_nuisances(out_of_model: bool = False) -> list[Effect]:
    """Return nuisances beyond their healthy range, where no term of the catalogue stands for that.

    The process noise of an out-of-model vehicle is unknown, but not free: enough of it explains any flight.
    """
    return [
        Effect(f"{n.name} out of range", relaxes=(n.name,))
        for n in NUISANCES
        if n.name != "vehicle.attitude_time_s" and (n.form != "log" or not out_of_model)
    ]


def _plain(term: Term) -> list[Effect]:
    """Return the term with its smooth parameters together; one whose sign cannot be observed, or that the
    catalogue marks so, is tried alone."""
    single = [p for p in term.smooth if p.alone or p.squared]
    groups = [[p] for p in single] + [[p for p in term.smooth if p not in single]]
    return [
        Effect(
            term.name, tuple(fitted_parameter(f"{term.name}.{p.name}").perturbation for p in group),
            parameters=tuple(p.name for p in group), positive=len(group) == 1 and group[0].least == 0.0,
        )
        for group in groups if group
    ]  # fmt: skip


def _at_values(column: str, values: Sequence[float], now: float) -> list[Effect]:
    """Return a term at each value of a grid, by one difference from its value ``now``."""
    name, _, parameter = column.partition(".")
    moved = [Perturbation(f"{name}{AT}{x:.4g}", *slot(column), x - now, unit=1.0) for x in values]
    return [Effect(name, (d,), (), (parameter,), True) for d in moved]


def _variance(name: str, column: str) -> Effect:
    """Return a term that adds noise."""
    return Effect(name, changes=(fitted_parameter(column),), parameters=("sigma",), positive=True)


ON_BOTH = (
    "one", "time", "height", "ahead", "left", "up", "speed2", "pitch", "roll", "turning", "north", "east",
)  # fmt: skip
ON_CHANNELS = (*ON_BOTH, "pitching", "rolling", "tilt2")
ON_FORCES = (*ON_BOTH, "stick_ahead", "stick_left", "stick_up", "stick_turn", "tilt2")
ON_ONE_CHANNEL = {"velocity_x": ("ahead when fast",), "velocity_y": ("left when fast",)}
"""Errors near the end of a sensor's range, which a scale does not describe."""
FORCED = ("roll", "pitch", "yaw_rate", "up", "ahead", "left", "gust_x", "gust_y")
AT_PLACE = ("x", "y", "r2")
"""Place to the second order about where a flight begins (a hill). Each flight has its own, as the places of
the others are unknown."""
_SPEED = CHANNELS.index("velocity_x")
FAST = 0.6
"""Share of the highest speed of a flight."""
YAW_AT_PLACE = "yaw ~ place"
"""Error of a compass above iron."""
LEVEL_TARGETS = (
    ("velocity_x", "velocity_y"), ("accel_x", "accel_y"), ("pitch", "roll"), ("gyro_y", "gyro_x"),
    ("force ahead", "force left"), ("force pitch", "force roll"),
)  # fmt: skip
"""Targets ahead and to the left: readings and forces."""
LEVEL_SIGNALS = (
    ("ahead", "left"), ("pitch", "roll"), ("stick_ahead", "stick_left"),
    ("ahead when fast", "left when fast"), ("pitching", "rolling"),
)  # fmt: skip
"""Signals that may act on these targets."""
TILTING_S = 0.02
"""Time before the moment over which a rate of tilt is taken: later values hold what the gyro will read."""


def residual_patterns(records: Sequence[Record]) -> tuple[Effect, ...]:
    """Return each residual pattern that the flights' streams can show, and pairs ahead and to the left.

    An isotropic error leaves half of its effect in each direction: one alone loses to a wrong term of both.
    """
    found = [
        Perturbation(f"{channel} ~ {signal}", "channel", c, 1.0, signal)
        for c, channel in enumerate(CHANNELS) if any(r.has(c) for r in records)
        for signal in (*ON_CHANNELS, *ON_ONE_CHANNEL.get(channel, ()))
    ]  # fmt: skip
    found += [
        Perturbation(f"force {name} ~ {signal}", "force", FORCES.index(name), 1e-3, signal)
        for name in FORCED
        if name != "yaw_rate" or any(r.shows_heading for r in records)
        for signal in ON_FORCES
        if signal != "stick_turn" or not any(holds_heading(r.stick) for r in records)
    ]
    if any(r.matches is not None for r in records):
        found += [Perturbation(name, "picture", k) for k, name in enumerate((*PICTURE_PATTERNS, *WARPS))]
    patterns = [Effect(d.name, (d,), positive=d.name in VARIANCE_PATTERNS) for d in found]
    yaw = CHANNELS.index("yaw")
    placed = [
        Perturbation(f"{YAW_AT_PLACE}: {signal}", "channel", yaw, 1.0, signal)
        for flight, record in enumerate(records)
        if record.has(yaw) and record.has(_SPEED)  # otherwise the place is unknown
        for signal in _of_flight(flight)
    ]
    patterns += [Effect(YAW_AT_PLACE, tuple(placed))] if placed else []
    known = {d.name: d for d in found}
    level = [
        (f"{ahead} ~ {along}", f"{left} ~ {across}")
        for ahead, left in LEVEL_TARGETS
        for along, across in LEVEL_SIGNALS
    ]
    both = [(known[one], known[other]) for one, other in (*level, *PAIRS) if {one, other} <= known.keys()]
    return (*patterns, *(Effect(f"{one.name}, {other.name}", (one, other)) for one, other in both))


def signals_of(record: Record, states: Array, flight: int = 0, flights: int = 1) -> dict[str, Signal]:
    """Return each signal in the middle of steps and at events, by filtered ``states`` (events, >= 10).

    Place belongs to one flight, number ``flight`` of ``flights``, and is 0 in the others.
    """
    at_events = _signals(record, record.times_s, states[:, :10])
    _, begin_s, length_s = record.steps
    middle = begin_s + length_s / 2
    moved = np.column_stack([np.interp(middle, record.times_s, column) for column in states[:, :10].T])
    at_steps = _signals(record, middle, moved)
    found = {name: (at_steps[name], at_events[name]) for name in at_steps}
    for other in range(flights):
        for name, signal in zip(AT_PLACE, _of_flight(other), strict=True):
            own = float(other == flight)
            found[signal] = (own * at_steps[name], own * at_events[name])
    return found


def _of_flight(flight: int) -> list[str]:
    return [f"{name} of flight {flight}" for name in AT_PLACE]


def _signals(record: Record, times_s: Array, states: Array) -> dict[str, Array]:
    x, y, z, vx, vy, vz, roll, pitch, yaw, turning = states.T
    x, y, c, s = x - x[0], y - y[0], np.cos(yaw), np.sin(yaw)
    ahead, left = c * vx + s * vy, c * vy - s * vx
    stick = record.stick.at(times_s)
    rates = [(tilt - np.interp(times_s - TILTING_S, times_s, tilt)) / TILTING_S for tilt in (pitch, roll)]
    speed = np.hypot(ahead, left)
    fast = np.maximum(speed / max(float(np.quantile(speed, 0.99)), 1e-3) - FAST, 0.0)
    return {
        "x": x, "y": y, "r2": x**2 + y**2,
        "one": np.ones(len(times_s)), "time": times_s / record.duration_s - 0.5, "height": z - 1.0,
        "ahead": ahead, "left": left, "up": vz, "speed2": vx**2 + vy**2,
        "pitch": pitch, "roll": roll, "turning": turning, "north": c, "east": s,
        "stick_ahead": stick[:, 0], "stick_left": stick[:, 1],
        "stick_up": stick[:, 2], "stick_turn": stick[:, 3],
        "ahead when fast": fast * ahead, "left when fast": fast * left,
        "pitching": rates[0], "rolling": rates[1], "tilt2": pitch**2 + roll**2,
    }  # fmt: skip
