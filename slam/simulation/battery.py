"""The battery: three lithium cells whose voltage falls with the charge drawn and dips with the current."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.streams import Scalar
from slam.simulation.chance import generator
from slam.simulation.dynamics import COMMAND
from slam.simulation.instruments import BatteryModel
from slam.simulation.model import Model
from slam.simulation.motion import Motion
from slam.simulation.sensors import clock_stamps, stamps

Array = NDArray[np.float64]

CELLS = 3
TILT_CURRENT, CLIMB_CURRENT = 0.8, 0.6
"""Additional current at full stick, forward or left and up, relative to the hover current."""
RATE_HZ = 50.0
"""Rate of the integration of charge; a command lasts longer."""


def open_circuit_v(charge: Array) -> Array:
    """Return the voltage at rest for a remaining charge of 0 to 1: a slope and a knee when nearly empty."""
    charge = np.clip(charge, 0.0, 1.0)
    return CELLS * (3.55 + 0.65 * charge - 0.5 * np.exp(-charge / 0.04))


def current_a(command: Array, battery: BatteryModel) -> Array:
    """Return the current (n,) in A under commands (n, ``dynamics.COMMAND``)."""
    forward, left, up = (command[:, COMMAND.index(name)] for name in ("forward", "left", "up"))
    more = TILT_CURRENT * np.hypot(forward, left) + CLIMB_CURRENT * up
    return battery.hover_current_a * np.maximum(1.0 + more, 0.0)


def read_battery(motion: Motion, model: Model, seed: int) -> Scalar:
    """Return the voltage. It does not act on the flight; the term ``battery_sag`` does."""
    battery, rng = model.battery, generator(seed, "battery")
    times = stamps(battery.rate_hz, motion.duration_s, rng)
    grid = np.linspace(0.0, motion.duration_s, int(np.ceil(motion.duration_s * RATE_HZ)) + 1)
    drawn = current_a(motion.stick.mean(grid[:-1], grid[1:]), battery) * np.diff(grid) / 3600
    left = battery.first_charge - np.concatenate([[0.0], np.cumsum(drawn)]) / battery.capacity_ah
    voltage = open_circuit_v(np.interp(times, grid, left))
    voltage -= battery.resistance_ohm * current_a(motion.stick.at(times), battery)
    voltage += rng.normal(0.0, battery.noise_std_v, len(times))
    return Scalar(clock_stamps(times, model, generator(seed, "battery clock")), voltage, battery.noise_std_v)
