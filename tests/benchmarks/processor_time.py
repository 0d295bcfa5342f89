"""Processor time of the stages of a map, which other work on the same machine does not lengthen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from unittest import mock

from slam.core import stage_timer


@contextmanager
def stages_by_processor() -> Iterator[None]:
    """Time stages by the clock of the processor, not by that of the wall."""
    with mock.patch.object(stage_timer, "time", SimpleNamespace(perf_counter=time.process_time)):
        yield
