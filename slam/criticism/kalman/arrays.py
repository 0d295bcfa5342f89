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
    spoilt_channels: Ints
    """(events,) number of the event's channels, from the first, that a nearby jump of the stick may spoil."""


class ModelArrays(NamedTuple):
    """The parameters of the vehicle and its instruments, as in ``FilterParameters``, and the noise."""

    parameters: Array
    """(``dynamics.PARAMETERS``,)."""
    sensor: Array
    hold: Array
    variance: Array
    """(channels,) variance of one reading."""
    range_limits_m: Array
    """(2,) least and greatest range that the sonar reports."""
    jitter_s: float
    diffusion: Array
    """(n,) growth of the variance of each state by process noise, per second."""


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
    """(n,) mean."""
    p: Array
    """(n, n) covariance."""
    outlier_streak: Array
    """(channels,) number of successive outliers."""
    sensitivity: Array
    """(n, m) derivative of the mean with respect to each perturbation."""


class Ar1Noise(NamedTuple):
    """State of k AR(1) noises, for a filter state of n entries with m sensitivities."""

    slot: Ints
    """(channels,) index of the channel's noise, or ``noise.WHITE``."""
    samples: Ints
    """(events,) number of samples since the instrument's last one, lost samples included."""
    coefficient: Array
    """(k,) AR(1) coefficient."""
    variance: Array
    """(k,) stationary variance."""
    mean: Array
    """(k,)."""
    cross: Array
    """(n, k) covariance with the state."""
    own: Array
    """(k, k) covariance."""
    sensitivity: Array
    """(k, m)."""
    reading_cov: Array
    """(k,) buffer: covariance of the noises with a reading."""


class NoiseChangeArrays(NamedTuple):
    """The filter under each of c changes of its noise, for n states and k AR(1) noises.

    Arrays that the plain filter has as well (``ModelArrays``, ``KalmanState``, ``Ar1Noise``,
    ``CommandArrays``) have a first axis (c,) where they depend on the change.
    """

    hold: Array
    decays_alike: Mask
    """(c,) whether the noises of the state decay as without the change."""
    variance: Array
    jitter_s: Array
    diffusion: Array
    p: Array
    shift: Array
    """(n, c) difference of the mean from the plain filter's."""
    coloured: Ar1Noise
    spoilt_channels: Ints
    before: Array
    """(n,) state of the plain filter before the step."""
    slower: Array
    """(c, n) change of the mean over a step by another decay."""
    matrix: Array
    """(n, n) buffer: transition, ..."""
    ph: Array
    """(n,) ... and covariances of the state with a reading."""
    untraced: Array
    """(0,): readings have no sensitivities."""


class StepBuffers(NamedTuple):
    """Results of the filter's last step."""

    rate: Array
    """(12,) rate of the state at the beginning of the step."""
    slopes: Array
    """(10, n) Jacobian of the rate in the filter's state."""
    matrix: Array
    """(n, n) transition."""
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
    """(n,) covariance of the state with a channel."""
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
    """Estimates around each event, for a smoother; without events where none is needed."""

    x_before: Array
    """(events, n) state before each event, ..."""
    x_after: Array
    """... and after it."""
    p_before: Array
    """(events, n, n) covariance."""
    p_after: Array
    t_before: Array
    """(events, n, m) sensitivities."""
    t_after: Array
    moves: Array
    """(events, n, n) transition to each event from the one before; identities before the run."""


class FilterRun(NamedTuple):
    """A run of the filter: a flight, the model, what the run updates in place, and its results."""

    events: EventArrays
    command: CommandArrays
    model: ModelArrays
    perturbations: PerturbationArrays
    estimate: KalmanState
    step: StepBuffers
    expected: PredictedReading
    changes: PerturbationBuffers
    scratch: Scratch
    written: KalmanOutputs
    coloured: Ar1Noise
    others: NoiseChangeArrays
    """The filters under changes of the noise."""
    history: PathHistory
    """It receives the estimates around each event, unless it is empty."""
