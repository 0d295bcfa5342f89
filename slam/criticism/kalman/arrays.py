"""Arguments of the filter's compiled kernels: named tuples of flat arrays."""

from __future__ import annotations

from typing import NamedTuple

from slam.core.arrays import Array, Ints, Mask


class EventArrays(NamedTuple):
    """The readings of a flight in order of time. Fields with a name of ``record.Record`` are its own."""

    times_s: Array
    kinds: Ints
    values: Array
    elapsed: Array
    landing: Mask
    samples: Ints
    """(events,) number of samples since the instrument's last one, lost samples included."""
    first_step: Ints
    """(events + 1,) the steps first_step[e] to first_step[e + 1] lead to event e."""
    step_s: Array
    """(steps,) lengths."""


class CommandArrays(NamedTuple):
    """Stick positions as they act on the vehicle: variant 0 with the nominal delay, others early or late."""

    over_steps: Array
    """(variants, steps, 6) means over each step."""
    at_events: Array
    """(variants, events, 6) values at each event."""
    stick_jumps: Array
    """(steps, 6) change of the stick within each step, ..."""
    late_var_s2: float
    """... and the variance of the time at which it acts."""


class ModelArrays(NamedTuple):
    """The parameters of the vehicle and its instruments, as in ``FilterParameters``."""

    parameters: Array
    """(``dynamics.PARAMETERS``,)."""
    sensor: Array
    range_limits_m: Array
    """(2,) least and greatest range that the sonar reports."""
    ar1_state: Ints
    """(channels,) state that holds the channel's AR(1) noise, or ``noise.WHITE``."""


class NoiseArrays(NamedTuple):
    """The noise of the model, and behind it c changed ones, under which the filter runs as well."""

    hold: Array
    """(1 + c, ``transition.HOLD``)."""
    decays_alike: Mask
    """(1 + c,) whether the noises of the state decay as under the first."""
    variance: Array
    """(1 + c, channels) variance of one reading."""
    ar1: Array
    """(1 + c, channels) AR(1) coefficient of the noise."""
    jitter_s: Array
    """(1 + c,)."""
    diffusion: Array
    """(1 + c, n) growth of the variance of each state by process noise, per second."""
    spoilt_channels: Ints
    """(1 + c, events) number of channels, from the first, that a nearby jump of the stick may spoil."""


class PerturbationArrays(NamedTuple):
    """The m perturbations of the model for which the filter computes sensitivities."""

    changes_motion: Ints
    """(m,) 1 where the perturbation changes the motion."""
    instrument_mask: Ints
    """(m,) bit k is set where it changes the readings of instruments of kind k."""
    stick_of: Ints
    """(m,) variant of the command."""
    parameters_of: Array
    """(m, ``dynamics.PARAMETERS``)."""
    sensor_of: Array
    """(m, ``readings.SENSOR``)."""
    inject_at: Ints
    """(m,) entry of the injected signal: a force, or a channel from ``sensitivity.ON_CHANNEL``; -1: none."""
    signal_of: Ints
    """(m,) index of the injected signal."""
    step_signals: Array
    """(signals, steps) values at the middle of each step."""
    event_signals: Array
    """(signals, events) values at each event."""
    scale: Array
    """(m,) factor from a finite difference to the derivative per unit of the perturbation."""


class KalmanState(NamedTuple):
    """The estimate that the filter updates from event to event."""

    state: Array
    """(n,) mean under the first noise."""
    p: Array
    """(1 + c, n, n) covariance under each noise."""
    shift: Array
    """(n, 1 + c) difference of the mean under each noise from that under the first."""
    outlier_streak: Array
    """(channels,) number of successive outliers."""
    sensitivity: Array
    """(n, m) derivative of the mean with respect to each perturbation."""


class StepBuffers(NamedTuple):
    """Results of the filter's last step."""

    rate: Array
    """(12,) rate of the state at the beginning of the step."""
    slopes: Array
    """(10, n) Jacobian of the rate in the filter's state."""
    matrix: Array
    """(n, n) transition under the first noise, ..."""
    other_matrix: Array
    """(n, n) ... and under another one."""
    before: Array
    """(n,) state before the step."""
    slower: Array
    """(1 + c, n) change of the mean over the step by another decay than under the first noise."""
    q: Array
    """(n, n) process noise of the noise states."""
    middle: Array
    """(12,) state in the middle of the step."""
    middle_noise: Array
    """(8,) noise in the middle of the step."""
    work: Array
    """(n, columns) buffer of the product of the transition and any matrix that a step carries."""
    late_stick_noise: Array
    """(10,) root of the variance that a late jump of the stick adds to the state, ..."""
    contact_variance: Array
    """(10,) ... and the variance that the gear's contact adds."""


class PredictedReading(NamedTuple):
    """Predicted values of an event's channels, and their derivatives."""

    rate: Array
    """(12,) rate of the state at the event."""
    reading: Array
    """(6,) predicted values."""
    rows: Array
    """(6, n) Jacobian in the state."""
    by_rate: Array
    """(6, 10) Jacobian in the state's rate."""
    ph: Array
    """(n,) covariance of the state with a channel under the first noise, ..."""
    other_ph: Array
    """(n,) ... and under another one."""
    correction: Array
    """(n,) correction of the state by the event's earlier channels."""


class PerturbationBuffers(NamedTuple):
    """Direct changes by the perturbations at a fixed state."""

    rate_change: Array
    """(entries, 10) change of the rate with a unit of force at each entry, ..."""
    is_used: Mask
    """(entries,) ... whether any perturbation has a force there, ..."""
    state_change: Array
    """(entries, 10) ... the change of the state over a step ..."""
    imu_change: Array
    """(entries, 6) ... and that of the IMU's readings."""
    direct: Array
    """(6, m) change of an event's channels at a fixed state."""
    predicted_change: Array
    """(m,) change of the prediction of one channel, that through the state included."""


class Scratch(NamedTuple):
    """Buffers within a kernel. No value outlasts a call."""

    full: Array
    """(12,) state of the equations, its rate, that at a nudged state, that under another model, and a sum."""
    rate: Array
    nudged_rate: Array
    other: Array
    total: Array
    noise: Array
    """(8,) noise of the equations, that at the end of a step, and that with an injected force."""
    ended: Array
    forced: Array
    stick: Array
    """(6,) command."""
    nudged: Array
    """(n,) state of the filter."""
    reading: Array
    """(6,) values of an event."""
    change: Array
    """(10,) change of a state's rate."""


class KalmanOutputs(NamedTuple):
    """The results that the filter writes; the first four as in ``innovations.FilterPass``."""

    innovation: Array
    log_variance: Array
    status: Ints
    states: Array
    sensitivity: Array
    """(readings, m) derivative of the prediction by each perturbation, over its standard deviation."""
    change_of_mean: Array
    """(readings, changes) change of the prediction by each change of the noise."""
    variance_ratio: Array
    """(readings, changes) variance of the innovation under each change, over the plain one."""
    rows: Ints
    """(1,) number of filled rows of the last three."""


class PathHistory(NamedTuple):
    """Estimates before and after each event, for a smoother; without events where none is needed."""

    x: Array
    """(2, events, n) mean."""
    p: Array
    """(2, events, n, n) covariance."""
    t: Array
    """(2, events, n, m) sensitivities."""
    moves: Array
    """(events, n, n) transition to each event from the one before; identities before the run."""


class FilterRun(NamedTuple):
    """A run of the filter: a flight, the model, what the run updates in place, and its results."""

    events: EventArrays
    command: CommandArrays
    model: ModelArrays
    noise: NoiseArrays
    perturbations: PerturbationArrays
    estimate: KalmanState
    step: StepBuffers
    expected: PredictedReading
    changes: PerturbationBuffers
    scratch: Scratch
    written: KalmanOutputs
    history: PathHistory
    """It receives the estimates around each event, unless it is empty."""
