"""Map accuracy gained by a model of the instruments: errors against truth before and after the correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.core.summary import without_nan
from slam.evaluation import Evaluation, evaluate
from slam.mapping.config import PipelineConfig
from slam.mapping.pipeline import optimize
from slam.simulation.inverse.correct import correct_flight
from slam.simulation.model import Model


@dataclass(frozen=True)
class MapErrors:
    """Errors of a map against the truth; NaN where there is no map."""

    position_m: float
    """Root mean square over keyframes in metres, with the first one's position and heading on the truth's."""
    scale: float
    """Factor that corrects the lengths of the map."""
    nees: float
    """Mean NEES of the poses: 6 where covariances are right, NaN where it is not known."""
    landmarks_percent: float
    """Largest error of a distance between landmarks, in percent; NaN where there are none."""

    @staticmethod
    def of(evaluation: Evaluation) -> MapErrors:
        """Collect the errors from an evaluation."""
        nees = evaluation.nees.pose.mean if evaluation.nees else float("nan")
        percent = [abs(row.error_percent.loops) for row in evaluation.landmarks]
        return MapErrors(evaluation.ate_m.rmse, evaluation.scale, nees, max(percent, default=float("nan")))

    @staticmethod
    def none() -> MapErrors:
        """Return the errors of a map that does not exist: all NaN."""
        return MapErrors(*[float("nan")] * 4)


@dataclass(frozen=True)
class MapGain:
    """Errors of the maps of one flight, as recorded and after the model's correction."""

    flight: str
    before: MapErrors
    after: MapErrors

    def to_json(self) -> dict[str, Any]:
        """Return the content of verdict.json and summary.json; figures that are not finite become null."""
        errors = {"before": dict(vars(self.before)), "after": dict(vars(self.after))}
        return dict(without_nan({"flight": self.flight, **errors}))


def can_be_compared(flight: Flight) -> bool:
    """Return whether a flight has the inputs of a map and a truth to compare it with."""
    return flight.camera is not None and flight.frames is not None and flight.truth is not None


def map_gain(
    flight: Flight,
    mended: Flight,
    after: Estimate | None = None,
    config: PipelineConfig = PipelineConfig(),
    progress: Progress = silent,
) -> MapGain:
    """Map the flight as recorded and as corrected (``mended``); ``after`` is the second map if it exists
    already.

    The flight must satisfy `can_be_compared`. The errors are NaN where the pictures cannot be joined.
    """
    before = _errors(flight, None, config, progress)
    return MapGain(flight.name, before, _errors(mended, after, config, progress))


def map_gains(
    flights: Sequence[Flight], model: Model, most: int | None = None, progress: Progress = silent
) -> list[MapGain]:
    """Compute the gains of the flights that satisfy `can_be_compared`, with the model's instrument errors
    removed.

    The shortest flights come first, as long as they have no more than ``most`` pictures together.
    """
    judged = sorted(filter(can_be_compared, flights), key=lambda flight: len(flight.frames or ()))
    total = accumulate(len(flight.frames or ()) for flight in judged)
    return [
        map_gain(flight, correct_flight(flight, model).flight, progress=progress)
        for flight, pictures in zip(judged, total, strict=True)
        if most is None or pictures <= most
    ]


def _errors(flight: Flight, made: Estimate | None, config: PipelineConfig, progress: Progress) -> MapErrors:
    try:
        return MapErrors.of(evaluate(made or optimize(flight, config, progress), flight))
    except InputError:
        return MapErrors.none()
