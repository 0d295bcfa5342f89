"""Bank of residual patterns that no term of the catalogue makes.

Signals (place, speed, tilt, stick, time) are led into each channel of the instruments, and into forces and
targets of the equations. A finding is reported as it is: channel, signal, size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.core.arrays import Array
from slam.criticism.camera.lens import PAIRS, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS, VARIANCE_PATTERNS
from slam.criticism.kalman.kernel_inputs import FORCES, Perturbation, Signal
from slam.criticism.kalman.readings import CHANNELS
from slam.criticism.kalman.record import Record, any_holds_heading
from slam.criticism.search.effects import Effect
from slam.simulation.dynamics import PITCH, ROLL, VX, VY, VZ, YAW, YAW_RATE, Z

ON_BOTH = (
    "one", "time", "height", "ahead", "left", "up", "speed2", "pitch", "roll", "turning", "north", "east",
)  # fmt: skip
ON_CHANNELS = (*ON_BOTH, "pitching", "rolling", "tilt2")
ON_FORCES = (*ON_BOTH, "stick_ahead", "stick_left", "stick_up", "stick_turn", "tilt2")
ON_ONE_CHANNEL = {"velocity_x": ("ahead when fast",), "velocity_y": ("left when fast",)}
"""Errors near the end of a sensor's range, which a scale does not describe."""
SIGNALS = tuple(dict.fromkeys((*ON_CHANNELS, *ON_FORCES, *sum(ON_ONE_CHANNEL.values(), ()))))
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


def pattern_directions(records: Sequence[Record]) -> list[Perturbation]:
    """Return the perturbations that the flights' streams can show."""
    channels = [c for c in range(len(CHANNELS)) if any(r.has(c) for r in records)]
    found = [
        Perturbation(f"{CHANNELS[c]} ~ {signal}", "channel", c, 1.0, signal)
        for c in channels
        for signal in (*ON_CHANNELS, *ON_ONE_CHANNEL.get(CHANNELS[c], ()))
    ]
    found += [
        Perturbation(f"force {name} ~ {signal}", "force", FORCES.index(name), 1e-3, signal)
        for name in FORCED
        if name != "yaw_rate" or any(r.shows_heading for r in records)
        for signal in ON_FORCES
        if signal != "stick_turn" or not any_holds_heading(records)
    ]
    if any(r.matches is not None for r in records):
        found += [Perturbation(name, "picture", k) for k, name in enumerate((*PICTURE_PATTERNS, *WARPS))]
    yaw = CHANNELS.index("yaw")
    found += [
        Perturbation(f"{YAW_AT_PLACE}: {signal}", "channel", yaw, 1.0, signal)
        for flight, record in enumerate(records)
        if record.has(yaw) and record.has(_SPEED)  # otherwise the place is unknown
        for signal in _of_flight(flight)
    ]
    return found


def residual_patterns(perturbations: Sequence[Perturbation]) -> tuple[Effect, ...]:
    """Return each perturbation as a pattern, and pairs of one kind ahead and to the left together.

    An isotropic error leaves half of its effect in each direction: one alone loses to a wrong term of both.
    """
    placed = tuple(d for d in perturbations if d.name.startswith(YAW_AT_PLACE))
    known = {d.name: d for d in perturbations if d not in placed}
    patterns = [Effect(name, (d,), positive=name in VARIANCE_PATTERNS) for name, d in known.items()]
    if placed:
        patterns.append(Effect(YAW_AT_PLACE, placed))
    together = [
        (f"{ahead} ~ {along}", f"{left} ~ {across}")
        for ahead, left in LEVEL_TARGETS
        for along, across in LEVEL_SIGNALS
    ]
    for names in (*together, *PAIRS):
        pair = known.get(names[0]), known.get(names[1])
        if pair[0] is not None and pair[1] is not None:
            patterns.append(Effect(f"{pair[0].name}, {pair[1].name}", (pair[0], pair[1])))
    return tuple(patterns)


def signals_of(record: Record, states: Array, flight: int = 0, flights: int = 1) -> dict[str, Signal]:
    """Return each signal in the middle of steps and at events, by filtered ``states`` (events, >= 10).

    Place belongs to one flight, number ``flight`` of ``flights``, and is 0 in the others.
    """
    at_events = _signals(record, record.times_s, states[:, :10])
    _, begin_s, length_s = record.steps
    middle = begin_s + length_s / 2
    moved = np.column_stack([np.interp(middle, record.times_s, column) for column in states[:, :10].T])
    at_steps = _signals(record, middle, moved)
    found = {name: (at_steps[name], at_events[name]) for name in SIGNALS}
    for other in range(flights):
        for name, signal in zip(AT_PLACE, _of_flight(other), strict=True):
            own = float(other == flight)
            found[signal] = (own * at_steps[name], own * at_events[name])
    return found


def _of_flight(flight: int) -> list[str]:
    return [f"{name} of flight {flight}" for name in AT_PLACE]


def _signals(record: Record, times_s: Array, states: Array) -> dict[str, Array]:
    c, s = np.cos(states[:, YAW]), np.sin(states[:, YAW])
    vx, vy = states[:, VX], states[:, VY]
    ahead, left = c * vx + s * vy, c * vy - s * vx
    stick = record.stick.at(times_s)
    elapsed = times_s / record.duration_s
    x, y = (states[:, :2] - states[0, :2]).T
    before = [np.interp(times_s - TILTING_S, times_s, states[:, k]) for k in (PITCH, ROLL)]
    pitching, rolling = (states[:, [PITCH, ROLL]].T - before) / TILTING_S
    speed = np.hypot(ahead, left)
    fast = np.maximum(speed / max(float(np.quantile(speed, 0.99)), 1e-3) - FAST, 0.0)
    return {
        "x": x, "y": y, "r2": x**2 + y**2,
        "one": np.ones(len(times_s)), "time": elapsed - 0.5, "height": states[:, Z] - 1.0,
        "ahead": ahead, "left": left, "up": states[:, VZ], "speed2": vx**2 + vy**2,
        "pitch": states[:, PITCH], "roll": states[:, ROLL], "turning": states[:, YAW_RATE],
        "north": c, "east": s,
        "stick_ahead": stick[:, 0], "stick_left": stick[:, 1],
        "stick_up": stick[:, 2], "stick_turn": stick[:, 3],
        "ahead when fast": fast * ahead, "left when fast": fast * left,
        "pitching": pitching, "rolling": rolling, "tilt2": states[:, PITCH] ** 2 + states[:, ROLL] ** 2,
    }  # fmt: skip
