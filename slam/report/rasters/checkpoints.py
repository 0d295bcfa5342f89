"""Checkpoints of the jobs on the pictures of a mosaic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from numpy.typing import NDArray

from frontend.mosaic.checkpoints import NO_MOSAIC_CHECKPOINTS, StageCheckpoints
from frontend.mosaic.plan import MosaicPlan
from frontend.surface.dense import DenseHeights
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.packing import digest_of, pack
from slam.core.picture_content import content_key
from slam.core.streams import Frames


class JobCheckpoints:
    """Results of jobs by the plan, the content of its pictures, and their items."""

    def __init__(self, checkpoints: Checkpoints, frames: Frames, frame_index: NDArray[Any]) -> None:
        """``frame_index`` (n,): the frame of each pose."""
        self.checkpoints = checkpoints

        @cache
        def content(k: int) -> bytes | None:
            return content_key(frames, int(frame_index[k]))

        self._content, self._told = content, set[str]()

    def stage(self, name: str, plan: MosaicPlan, *others: object) -> StageCheckpoints:
        """Return the results of jobs that depend on a plan, on its pictures, and on ``others``."""
        contents = [self._content(view.k) for view in plan.views] if self.checkpoints.are_kept else [None]
        if None in contents:
            return NO_MOSAIC_CHECKPOINTS.stage(name, plan, *others)
        return _JobsOfStage(self, name, digest_of((name, plan, contents, others)))

    def recall(self, stage: str, key: bytes) -> Any:
        """Return the result of a job; None where it is not known. The first of each stage is told."""
        found = recall_as(object, self.checkpoints, "mosaic", key, (DenseHeights,))
        if found is not None and stage not in self._told:
            self._told.add(stage)
            self.checkpoints.say(f"resumed: parts of the mosaic's {stage} are known")
        return found


@dataclass(frozen=True)
class _JobsOfStage:
    """Results of the jobs of one stage."""

    jobs: JobCheckpoints
    name: str
    made_of: bytes

    def recall(self, item: object) -> Any:
        """Return the result for an item; None where it is not known."""
        return self.jobs.recall(self.name, digest_of((self.made_of, item)))

    def keep(self, item: object, result: object) -> None:
        """Keep the result for an item."""
        self.jobs.checkpoints.keep("mosaic", digest_of((self.made_of, item)), pack(result))
