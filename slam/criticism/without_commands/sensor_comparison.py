"""Comparison of the instruments of flights: inertial consistency, pictures, and single readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from slam.core.flight import Flight
from slam.core.progress import Progress, Tally, silent
from slam.criticism.camera.feature_matches import FeatureMatches, match_all_pictures
from slam.criticism.camera.mismatched_pairs import without_mismatched_pairs
from slam.criticism.kalman.filter_parameters import FilterParameters, filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.reading_anomalies import ReadingAnomaly, reading_anomalies, without_dead_zone
from slam.criticism.threads import in_threads
from slam.criticism.without_commands.free_motion import airborne_record, with_free_motion
from slam.criticism.without_commands.inertial_consistency import inertial_residuals
from slam.criticism.without_commands.pictures import picture_rows
from slam.criticism.without_commands.regression import Sizes
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.simulation.model import Model


@dataclass(frozen=True)
class SensorComparison:
    """Flights with the comparisons of their instruments."""

    comparisons: tuple[list[WhitenedRows], ...]
    records: tuple[Record | None, ...]
    """Readings of each flight in the air, with its pictures; None where it is not known to fly."""
    parameters: FilterParameters
    """Filter parameters with inflated process noise."""
    anomalies: tuple[ReadingAnomaly, ...]
    """Anomalies of single readings."""
    dropped: tuple[str, ...]
    """Descriptions of what was left out."""

    @property
    def matches(self) -> FeatureMatches | None:
        """Feature matches of the first flight that has any."""
        every = (record.matches for record in self.records if record is not None)
        return next((matches for matches in every if matches is not None), None)

    def rows(self, sizes: Sizes) -> list[list[WhitenedRows]]:
        """Return the rows of each flight; those of pictures are linear about such ``sizes`` as the parameters
        can hold."""

        def of_pictures(record: Record | None) -> list[WhitenedRows]:
            if record is None or record.matches is None:
                return []
            return picture_rows(record, self.parameters, sizes)

        pictures = in_threads(of_pictures, self.records)
        return [[*known, *more] for known, more in zip(self.comparisons, pictures, strict=True)]


def compare_sensors(flights: Sequence[Flight], model: Model, progress: Progress = silent) -> SensorComparison:
    """Compare each instrument of the flights with the others."""
    comparisons = [
        inertial_residuals(flight) for flight in Tally(progress, "instruments", len(flights)).each(flights)
    ]
    parameters = with_free_motion(filter_parameters_of(model))
    records, dropped = [], []
    for record, matches in zip(
        map(airborne_record, flights), match_all_pictures(flights, progress), strict=True
    ):
        if record is None or matches is None:
            records.append(record)
            continue
        known, description = without_mismatched_pairs(replace(record, matches=matches), parameters)
        records.append(known)
        dropped += [description] if description else []
    return SensorComparison(
        tuple(comparisons), tuple(records), parameters, tuple(_anomalies(records, parameters)), tuple(dropped)
    )


def _anomalies(records: Sequence[Record | None], parameters: FilterParameters) -> list[ReadingAnomaly]:
    known = [record for record in records if record is not None]
    if not known:
        return []
    clean, found = without_dead_zone(known)
    passes = in_threads(lambda record: whole(record, parameters), clean)
    return [*found, *reading_anomalies(clean, passes)]
