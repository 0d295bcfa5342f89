"""The flights that a map was made from, corrected and joined as `slam optimize` did it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.io.recordings.choice import Request


def mapped_flight(folder: Path, sources: Sequence[Path], request: Request) -> Flight:
    """Return the flights joined, corrected by the model that the map in ``folder`` was made with.

    ``request`` says what to take from recordings, as for the map. Raises ``InputError`` for a flight or a
    model that cannot be read.
    """
    from slam.cli.output_folder import MODEL_NAME
    from slam.cli.source import open_flight
    from slam.core.join_flights import join_flights
    from slam.core.progress import silent

    flights = [open_flight(path, silent, request)[0] for path in sources]
    if (folder / MODEL_NAME).exists():
        from slam.simulation.inverse import correct_flight
        from slam.simulation.model import load_model

        model = load_model(folder / MODEL_NAME)
        flights = [correct_flight(flight, model).flight for flight in flights]
    return join_flights(flights)
