"""The summary of a map as JSON."""

from __future__ import annotations

import json

from slam.core.summary import json_text, summarise
from tests.slam.made_estimate import made_estimate


def test_summary_has_the_keys_of_the_contract():
    estimate = made_estimate()
    record = summarise(estimate, landmarks=2).to_json()
    assert set(record) == {
        "status", "frames", "keyframes", "edges", "landmarks", "timing_s", "peak_rss_mb", "warnings", "notes",
            "height_sensor",
    }  # fmt: skip
    assert record["edges"] == {"odometry": 59, "loop": 2, "rejected": estimate.rejected}
    assert 10 < record["peak_rss_mb"] < 10_000
    graph = summarise(estimate, graph_alone=True).to_json()
    assert set(graph) - set(record) == {"error", "iterations"}


def test_json_has_no_nan():
    text = json_text({"a": float("nan"), "b": [float("inf"), 1.5], "c": ("x",)})
    assert json.loads(text) == {"a": None, "b": [None, 1.5], "c": ["x"]}
