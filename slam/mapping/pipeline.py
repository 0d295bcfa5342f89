"""The post-flight job: a flight in, optimized keyframes out.

What a map needs takes a second to load. It is loaded by the first map, not by a program that imports these
functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slam.core.checkpoints import NO_CHECKPOINTS, Checkpoints
from slam.core.heap import trim_heap
from slam.core.progress import Progress, silent

if TYPE_CHECKING:
    from slam.core.estimate import Estimate
    from slam.core.flight import Flight
    from slam.mapping.config import PipelineConfig
    from slam.mapping.front_end import Observations
    from slam.mapping.tracked_pictures import TrackedPictures


def optimize(flight: Flight, config: PipelineConfig | None = None, progress: Progress = silent) -> Estimate:
    """Estimate trajectory, loops and covariances of a flight with a down-looking camera.

    ``config``: the settings of the stages, by default those of ``PipelineConfig()``.

    Raises ``InputError`` where the flight has no camera or its pictures cannot be joined.
    """
    estimate = optimize_with_observations(flight, config, progress)[0]
    trim_heap()
    return estimate


def optimize_with_observations(
    flight: Flight,
    config: PipelineConfig | None = None,
    progress: Progress = silent,
    tracked: TrackedPictures | None = None,
    checkpoints: Checkpoints = NO_CHECKPOINTS,
) -> tuple[Estimate, Observations]:
    """Return the estimate and the front end's observations: features, and registrations of keyframes.

    ``config`` as for ``optimize``; ``tracked``: the result of tracking the flight's pictures, if that is done
    already. ``checkpoints``: where the results of expensive work are kept, and those of an earlier run.
    """
    from slam.mapping.config import PipelineConfig
    from slam.mapping.main_loop import map_flight

    return map_flight(flight, config or PipelineConfig(), progress, tracked, checkpoints)
