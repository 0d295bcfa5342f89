"""What the filter's kernels read and write: flat arrays, so that compiled code can."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class EventArrays(NamedTuple):
    """The readings of a flight in their order of time, as ``record.Record`` has them."""

    times_s: Array
    """(events,)."""
    kinds: Ints
    """(events,) ``readings.IMU`` and so on."""
    values: Array
    """(events, 6), NaN for what is missing."""
    elapsed: Array
    """(events,) share of the flight's duration that is over."""
    landing: NDArray[np.bool_]
    """(events,) on the floor and just after."""
    first_step: Ints
    """(events + 1,) event e is reached by steps first_step[e] to first_step[e + 1]."""
    step_s: Array
    """(steps,) lengths."""


class CommandArrays(NamedTuple):
    """The sticks that the vehicle obeys; variant 0 is the belief's own, others are early or late."""

    over_steps: Array
    """(variants, steps, 6) means over each step."""
    at_events: Array
    """(variants, events, 6)."""
    jolts: Array
    """(steps, 6) how far the stick jumps within each step, ..."""
    late_var_s2: float
    """... at a moment of this variance."""
    jumps: Ints
    """(events,) how many of the event's channels, from the first, a jump of the stick near it may spoil."""


class ModelArrays(NamedTuple):
    """What the vehicle and its instruments are held for."""

    parameters: Array
    """(``dynamics.PARAMETERS``,)."""
    sensor: Array
    """(``readings.SENSOR``,)."""
    hold: Array
    """(``transition.HOLD``,)."""


class NoiseArrays(NamedTuple):
    """How far a reading is believed."""

    variance: Array
    """(channels,) of one reading."""
    range_limits_m: Array
    """(2,) least and greatest range that the sonar reports."""
    jitter_s: float
    """Standard deviation of the stamps."""
    rough: Array
    """(n,) growth of each hold noise's variance by its kicks, a second."""


class PerturbationArrays(NamedTuple):
    """Directions, m of them: the changes of a belief that tangents are carried for."""

    changes_motion: Ints
    """(m,) 1 where it changes the motion."""
    instrument_mask: Ints
    """(m,) bit k is set where it changes what instruments of kind k read."""
    stick_of: Ints
    """(m,) variant of the command."""
    parameters_of: Array
    """(m, ``dynamics.PARAMETERS``)."""
    sensor_of: Array
    """(m, ``readings.SENSOR``)."""
    inject_at: Ints
    """(m,) where a signal goes in: a force, a channel beyond ``sensitivity.ON_CHANNEL``; -1 for none."""
    signal_of: Ints
    """(m,) which signal."""
    step_signals: Array
    """(signals, steps) at the middle of each step."""
    event_signals: Array
    """(signals, events)."""
    scale: Array
    """(m,) differences times this are per unit of the direction."""


class FilterInputs(NamedTuple):
    """A flight, and all that it is filtered under."""

    events: EventArrays
    command: CommandArrays
    belief: ModelArrays
    noise: NoiseArrays
    perturbations: PerturbationArrays


class FilterState(NamedTuple):
    """What the filter carries on from event to event."""

    state: Array
    """(n,)."""
    p: Array
    """(n, n) covariance."""
    memory: Array
    """(channels,) outliers in a row."""
    sensitivity: Array
    """(n, m) change of the state with each direction."""


class StepBuffers(NamedTuple):
    """The filter's last step."""

    rate: Array
    """(12,) of the state, at its beginning."""
    slopes: Array
    """(10, n) Jacobian of the rate in the filter's state."""
    matrix: Array
    """(n, n) transition."""
    q: Array
    """(n, n) process noise of the noises."""
    middle: Array
    """(12,) state half-way."""
    middle_noise: Array
    """(8,) noise half-way."""
    work: Array
    """(n, n) room to work."""


class PredictedReading(NamedTuple):
    """What the channels of an event should read, and what the reading does."""

    rate: Array
    """(12,) of the state at the event's moment."""
    reading: Array
    """(6,)."""
    rows: Array
    """(6, n) Jacobian in the state."""
    by_rate: Array
    """(6, 10) Jacobian in the state's rate."""
    ph: Array
    """(n,) covariance of the state with a channel."""
    done: Array
    """(n,) what the event's channels did to the state so far."""


class PerturbationBuffers(NamedTuple):
    """What the directions do by themselves, the state left alone."""

    rate_change: Array
    """(entries, 10) of the rate, with a unit of force at each entry ..."""
    is_used: NDArray[np.bool_]
    """(entries,) ... at which any direction puts one, ..."""
    state_change: Array
    """(entries, 10) ... of the state over a step with it ..."""
    read: Array
    """(entries, 6) ... and of what an IMU reads."""
    added: Array
    """(10,) of the state, over a step."""
    direct: Array
    """(6, m) of an event's channels."""
    told: Array
    """(m,) of one channel, what they do to the state included."""
    moved: Array
    """(10, m) room to work."""


class Scratch(NamedTuple):
    """Room within a kernel: nothing in it outlasts a call."""

    full: Array
    """(12,) a state of the equations, ..."""
    rate: Array
    """... its rate, ..."""
    beside: Array
    """... that with something nudged, ..."""
    other: Array
    """... that under another belief, ..."""
    total: Array
    """... and a sum of rates."""
    noise: Array
    """(8,) noise of the equations, ..."""
    ended: Array
    """... at the end of a step, ..."""
    forced: Array
    """... and with a force put in."""
    stick: Array
    """(6,)."""
    nudged: Array
    """(n,) a state of the filter."""
    reading: Array
    """(6,) of an event."""
    change: Array
    """(10,) of a state's rate."""


class Workspace(NamedTuple):
    """What one event after the other is worked out in."""

    step: StepBuffers
    expected: PredictedReading
    changes: PerturbationBuffers
    scratch: Scratch


class FilterOutputs(NamedTuple):
    """What the filter leaves behind."""

    innovation: Array
    """(events, 6) over its standard deviation."""
    log_variance: Array
    """(events, 6) of the innovation."""
    status: Ints
    """(events, 6) ``filter.USED`` and so on."""
    states: Array
    """(events, 11) moving state before the event, and the standard deviation of z."""
    sensitivity: Array
    """(readings, m) change of the prediction with each direction, over its standard deviation."""
    rows: Ints
    """(1,) how many rows of the traces are filled."""
