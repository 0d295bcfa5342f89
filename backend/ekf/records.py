"""What the filter's passes read and write: flat arrays, so that compiled code can."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


USED, REFUSED, STEPPED, SOFTENED, UNABLE = 1, 2, 3, 4, 5
"""What became of a component of a reading: taken; rejected by the gate; taken as a step of the instrument's
own bias, after all readings failed the gate for too long; taken with inflated noise; not predictable in this
state."""


class FilterEvents(NamedTuple):
    """All that happens in a flight, in order of time."""

    stamps_s: Array
    """(e,)."""
    kind: NDArray[np.int64]
    """(e,) see `backend.ekf.readings`."""
    value: Array
    """(e, 3) the reading; NaN where a component is not there."""
    std: Array
    """(e, 3)."""
    row: NDArray[np.int64]
    """(e,) which step of the pictures, or which asked pose."""
    step: Array
    """(s, 4, 4) steps seen in pictures."""
    step_whitener: Array
    """(s, 6, 6) times the error of a step: unit covariance."""


class Gates(NamedTuple):
    """When a reading is not taken as it is."""

    component: float
    """Largest squared whitened innovation of a component."""
    step: float
    """The same of a step seen in pictures, as a whole."""
    patience_s: float
    """Seconds for which readings may fail the gate."""


class FilterInputs(NamedTuple):
    """A flight, and all that it is filtered under."""

    events: FilterEvents
    about: Array
    """(e, STATE) states to linearise about; of no length in the first round."""
    model: Array
    """(MOTION + 9,) see `backend.ekf.motion`; then the beam, the places of rangefinder and camera."""
    gates: Gates


class FilterState(NamedTuple):
    """What the filter carries on from event to event; changed in place."""

    x: Array
    """(STATE,) nominal state."""
    e: Array
    """(n,) mean of its error: not zero where the linearisation point is given."""
    C: Array
    """(n, n) covariance of the error."""
    refused_since: Array
    """(kinds, 6) since when each component is beyond its gate; infinite where it is not."""


class LinearizedReading(NamedTuple):
    """One reading as the update takes it."""

    event: int
    taped: int
    """Its event's number within the block."""
    kind: int
    now_s: float
    innovation: Array
    """(6,) reading minus prediction at the linearisation point; NaN where nothing was read."""
    H: Array
    """(6, n) its derivatives by the error."""
    variance: Array
    """(6,) of the white noise."""


class InnovationLog(NamedTuple):
    """What became of each component of each reading."""

    status: NDArray[np.int64]
    """(e, 6) see above; 0 where there was none."""
    innovation: Array
    """(e, 6) innovations, conditioned on the components before; of a step whitened."""
    variance: Array
    """(e, 6) their predicted variances."""


class StateRecords(NamedTuple):
    """State and covariance at the asked times, and the states that a next round is linearised about."""

    x: Array
    """(q, STATE)."""
    C: Array
    """(q, r, r) of the error, ``rows`` alone."""
    std: Array
    """(q, n) of every part of the state."""
    all_x: Array
    """(e, STATE) behind every event; of no length where nobody needs them."""
    rows: NDArray[np.int64]
    """(r,) which parts of the error are told with their covariance."""


class Tape(NamedTuple):
    """What the backward pass needs of each event of a block; of no length where none follows."""

    F: Array
    """(b, 9, 3) figures of the transition to it; zero where no time passed."""
    H: Array
    """(b, 6, n)."""
    K: Array
    """(b, 6, n) gains."""
    S: Array
    """(b, 6) variances of the innovations."""
    innovation: Array
    """(b, 6)."""
    dof: NDArray[np.int64]
    """(b,) components that were taken."""
    x: Array
    """(b, STATE) state behind it."""
    C: Array
    """(b, n, n)."""


class FilterOutputs(NamedTuple):
    """What the pass forward leaves behind."""

    log: InnovationLog
    found: StateRecords
    tape: Tape
