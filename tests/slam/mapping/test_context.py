"""What stays of a map's inputs where it is made again with another calibration."""

from __future__ import annotations

from dataclasses import fields, replace

from backend.clocks.picture_clock import PictureClock
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.stage_timer import Stopwatch
from slam.mapping import context as module
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context, Job
from tests.slam.small_flight import flown


def test_a_calibrated_context_keeps_all_but_what_the_calibration_changes(monkeypatch):
    monkeypatch.setattr(module, "_at_keyframes", lambda *_: ("setup", "bridges"))
    camera = flown(0).camera
    job = Job(camera, PipelineConfig(), silent, Stopwatch())
    values = {f.name: f"{f.name} before" for f in fields(Context)}
    before = Context(**values | {"flight": Flight("small"), "job": job})
    other, clock = replace(camera, focal_px=(1.0, 1.0)), PictureClock((), 0.1)
    after = before.calibrated(clock, other, None)
    changed = {"job": replace(job, camera=other), "setup": "setup", "bridges": "bridges", "clock": clock}
    for f in fields(Context):
        assert getattr(after, f.name) == changed.get(f.name, getattr(before, f.name)), f.name
