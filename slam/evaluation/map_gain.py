"""What a model of the instruments gains in the map: error against truth before and after it is taken out."""

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
    """How far a map is from the truth; NaN where there is no map."""

    position_m: float
    """Root mean square over keyframes, the first one's position and heading on the truth's."""
    scale: float
    """What lengths of the map must be multiplied by."""
    nees: float
    """Mean of the poses; 6 where covariances are right, NaN where it cannot be told."""
    landmarks_percent: float
    """Largest error of a distance between landmarks; NaN where there are none."""

    @staticmethod
    def of(evaluation: Evaluation) -> MapErrors:
        """From all figures of an evaluation."""
        nees = evaluation.nees.pose.mean if evaluation.nees else float("nan")
        percent = [abs(row.error_percent.loops) for row in evaluation.landmarks]
        return MapErrors(evaluation.ate_m.rmse, evaluation.scale, nees, max(percent, default=float("nan")))

    @staticmethod
    def none() -> MapErrors:
        """Of a map that is not there."""
        return MapErrors(*[float("nan")] * 4)


@dataclass(frozen=True)
class MapGain:
    """The maps of one flight, as recorded and with a model taken out."""

    flight: str
    before: MapErrors
    after: MapErrors

    def to_json(self) -> dict[str, Any]:
        """As verdict.json and summary.json hold it; what is not finite becomes null."""
        return dict(
            without_nan(
                {
                    "flight": self.flight,
                    "before": dict(vars(self.before)),
                    "after": dict(vars(self.after)),
                }
            )
        )


def can_be_compared(flight: Flight) -> bool:
    """Whether a flight has what a map is made of, and a truth to hold it against."""
    return flight.camera is not None and flight.frames is not None and flight.truth is not None


def map_gain(
    flight: Flight,
    mended: Flight,
    after: Estimate | None = None,
    config: PipelineConfig = PipelineConfig(),
    progress: Progress = silent,
) -> MapGain:
    """Map the flight as recorded and as ``mended``; ``after`` is the second map where it is there already.

    Needs a flight that `can_be_compared`; where the pictures cannot be joined the errors are NaN.
    """
    before = _errors(flight, None, config, progress)
    return MapGain(flight.name, before, _errors(mended, after, config, progress))


def map_gains(
    flights: Sequence[Flight], model: Model, most: int | None = None, progress: Progress = silent
) -> list[MapGain]:
    """Of the flights that `can_be_compared`, with what the model says of their instruments taken out.

    The shortest first, as long as they have no more than ``most`` pictures together.
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
