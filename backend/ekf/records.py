"""Inputs and outputs of the filter's passes, as flat arrays for compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


USED, REJECTED, BIAS_STEPPED, INFLATED, UNPREDICTABLE = 1, 2, 3, 4, 5
"""Status of a component of a reading: used; rejected by the gate; used as a step of the instrument's bias,
after all readings failed the gate for too long; used with inflated noise; unpredictable in this state."""


class FilterEvents(NamedTuple):
    """All events of a flight, in order of time."""

    stamps_s: Array
    """(e,)."""
    kind: NDArray[np.int64]
    """(e,) kind of event; see `backend.ekf.readings`."""
    value: Array
    """(e, 3) reading; NaN for a missing component."""
    std: Array
    """(e, 3)."""
    row: NDArray[np.int64]
    """(e,) index of the visual step or of the requested time."""
    step: Array
    """(s, 4, 4) visual steps."""
    step_whitener: Array
    """(s, 6, 6) matrices that whiten the error of a step."""


class Gates(NamedTuple):
    """Thresholds of the innovation gates."""

    component: float
    """Largest squared whitened innovation of a component."""
    step: float
    """Largest squared Mahalanobis norm of a visual step."""
    patience_s: float
    """Time, in seconds, for which readings may fail the gate."""


class FilterInputs(NamedTuple):
    """Inputs of the filter: a flight's events and the model."""

    events: FilterEvents
    linearization: Array
    """(e, STATE) linearisation points; empty in the first round."""
    model: Array
    """(LEVERS + 12,) see `backend.ekf.motion`; the levers go from the IMU to rangefinder, camera, antenna and
    the body's origin."""
    gates: Gates


class FilterState(NamedTuple):
    """State of the filter between events; updated in place."""

    x: Array
    """(STATE,) nominal state."""
    e: Array
    """(n,) mean of the error state: nonzero if the linearisation point is an input."""
    C: Array
    """(n, n) covariance of the error."""
    failing_since: Array
    """(kinds, 6) time since which each component fails its gate; infinite if it passes."""


class FilterBuffers(NamedTuple):
    """Buffers of the kernels. The first three hold one reading, linearised for the update."""

    innovation: Array
    """(6,) reading minus prediction at the linearisation point; NaN for a missing component."""
    H: Array
    """(6, n) Jacobian by the error state."""
    variance: Array
    """(6,) variance of the white noise."""
    Ch: Array
    """(n,) covariance of the state with one component."""
    L: Array
    """(6, 7) Cholesky factor of the covariance of a visual step's innovations, and these whitened."""
    F: Array
    """(MOVING, MOVING) transition of the moving part of the state."""
    moved: Array
    """(MOVING, n) buffer of the propagation."""
    LC: Array
    """(n, n) product of the adjoint L and a covariance."""


class InnovationLog(NamedTuple):
    """Status and innovation of each component of each reading."""

    status: NDArray[np.int64]
    """(e, 6) status, see above; 0 for a missing component."""
    innovation: Array
    """(e, 6) innovations, conditioned on the previous components; those of a step are whitened."""
    variance: Array
    """(e, 6) their predicted variances."""


class StateRecords(NamedTuple):
    """States and covariances at the requested times, and linearisation points for the next round."""

    x: Array
    """(q, STATE)."""
    C: Array
    """(q, r, r) covariance of the error state, only its ``rows``."""
    std: Array
    """(q, n) standard deviation of each element of the error state."""
    all_x: Array
    """(e, STATE) state after each event; empty if not needed."""
    rows: NDArray[np.int64]
    """(r,) indices of the error state whose covariance is recorded."""


class Tape(NamedTuple):
    """Inputs of the backward pass from each event of a block; empty if no such pass follows."""

    F: Array
    """(b, MOVING, MOVING) transition to the event; zero if no time passed."""
    H: Array
    """(b, 6, n)."""
    K: Array
    """(b, 6, n) gains."""
    S: Array
    """(b, 6) variances of the innovations."""
    innovation: Array
    """(b, 6)."""
    dof: NDArray[np.int64]
    """(b,) number of components that were used."""
    x: Array
    """(b, STATE) state after the event."""
    C: Array
    """(b, n, n)."""


class FilterOutputs(NamedTuple):
    """Outputs of the forward pass."""

    log: InnovationLog
    found: StateRecords
    tape: Tape
