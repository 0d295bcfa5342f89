"""Parts of the flights that speak of one size agree; parts that do not are found out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism.finding import Inconsistency
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import MEAN_PERTURBATIONS, fitted_parameter
from slam.criticism.search.information import FisherInformation
from slam.criticism.verdict import over_time
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.over_time import (
    FEWEST_SIZES,
    Parts,
    SizeOverTime,
    _inconsistency,
    changing_sizes,
)
from slam.report.criticism.findings import concerned
from slam.simulation.model import load_model

ROWS, PARTS = 6000, 6


def drawn(seed, sizes):
    """Traces of two nuisances and a cause, innovations with the cause's size in each part, and the parts."""
    rng = np.random.default_rng(seed)
    traces = rng.standard_normal((ROWS, 3)) * 0.3
    part = rng.integers(0, PARTS, ROWS)
    white = rng.standard_normal(ROWS) + traces @ [0.5, -0.2, 0.0] + traces[:, 2] * np.asarray(sizes)[part]
    return traces, white, part


def deviates(sizes, count=200):
    def deviate(seed):
        known = FisherInformation.of_rows("abc", *drawn(seed, sizes), np.arange(PARTS))
        effect, own = Effect("yaw_drag"), np.array([2])
        found = _inconsistency(effect, "during a flight", known, own, np.full(3, 1e-9))
        return 0.0 if found is None else found.z

    return np.array([deviate(seed) for seed in range(count)])


def test_one_size_in_all_parts_agrees():
    z = deviates([1.0] * PARTS)
    # Half of the chi-squares lie below their mean or near it; one in twenty beyond the two-sided 1.96.
    assert np.mean(z > 1.96) < 0.1
    assert np.mean(z > 1.96) > 0.005
    assert z.max() < 4.0


@pytest.mark.parametrize("sizes", [[1, 1, 1, 1, 1, 0], [1, -1, 1, -1, 1, -1]])
def test_sizes_that_differ_do_not(sizes):
    assert np.median(deviates(sizes, 20)) > 4.0


def test_a_part_that_hardly_shows_a_size_is_left_out_of_its_course():
    scale = Effect("sonar_scale", (fitted_parameter("sonar_scale.eps").perturbation,), (), ("eps",))
    information = np.array([1e4, 1e3, 1.0])
    score = 0.1 * information + [0.0, 50.0, 9.0]
    known = FisherInformation(
        scale.columns, np.array([0, 0, 1]), information[:, None, None], score[:, None], np.zeros(3)
    )
    parts = Parts(known, ["a", "b"], np.arange(3.0))
    healthy = filter_parameters_of(load_model("nominal"))
    (found,) = parts.sizes_over_time(scale, np.array([0.1]), healthy)
    assert found.flights == ("a", "a")
    assert found.sizes == pytest.approx([0.1, 0.15])
    assert found.errors == pytest.approx([0.01, 0.0316], rel=0.01)
    assert found.common == pytest.approx(0.1)
    assert parts.sizes_over_time(Effect("timestamp_jitter"), np.array([0.1]), healthy) == []


@pytest.mark.parametrize(
    ("middle", "swing", "error", "varies"),
    [(0.1, 0.1, 0.01, True), (0.1, 0.03, 0.01, False), (0.1, 0.1, 0.08, False), (0.0, 0.1, 0.01, True)],
)
def test_a_size_varies_by_half_of_itself_and_by_more_than_chance(middle, swing, error, varies):
    sizes = middle + swing * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    count = len(sizes)
    found = SizeOverTime(
        effect="flow_scale", parameter="eps", unit="1", flights=("a",) * count, begin_s=np.arange(count),
        sizes=sizes, errors=np.full(count, error), common=middle,
    )  # fmt: skip
    assert found.varies == varies
    assert not replace(found, effect="motion_blur", parameter="exposure").varies
    few = replace(found, sizes=sizes[: FEWEST_SIZES - 1], errors=found.errors[: FEWEST_SIZES - 1])
    assert not few.varies
    told = replace(found, part_s=10.0).finding()
    assert (told.least, told.most) == pytest.approx((middle - swing, middle + swing))
    assert told.like_attitude_deg == 0.0


def test_a_delay_that_changes_is_told_of_its_instrument_and_has_no_sizes_over_time(monkeypatch):
    """A log of the sticks with late rows makes one: it belongs to no term of the catalogue."""
    healthy = filter_parameters_of(load_model("nominal"))
    late = Effect("attitude late", (fitted_parameter("attitude.delay_s").perturbation,))
    columns = [d.name for d in (*MEAN_PERTURBATIONS, *late.perturbations)]
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(40, len(columns))), rng.normal(size=40), np.arange(40) % 8
    parts = Parts(FisherInformation.of_rows(columns, *rows, np.zeros(8, np.int64)), ["a"], np.arange(8.0))
    monkeypatch.setattr(over_time, "_parts_of", lambda *_: [parts] * 3)
    found = SimpleNamespace(chosen=(late,), last=SimpleNamespace(effects=[late]), model=healthy, records=[])
    assert changing_sizes(found, healthy, {late.name}) == ()
    changes = Inconsistency("during a flight", 50.0, is_cause=False, effect=late.name, z=9.0)
    assert concerned(Criticism("unknown", findings=(changes,))) == ["the attitude"]


@pytest.mark.parametrize(
    ("excess", "out_of_model", "refuted"),
    [(3284.7, False, True), (300.0, False, False), (3284.7, True, False)],
)
def test_a_limit_that_contradicts_itself_more_than_it_gains_is_rejected(
    monkeypatch, excess, out_of_model, refuted
):
    """Its gain is that of held-out flights, as no expansion about it shows what it explains."""
    limit = Effect("tilt_limit", (fitted_parameter("tilt_limit.limit").perturbation,), (), ("limit",))
    last = SimpleNamespace(score_tests=lambda rest, among: [SimpleNamespace(z=0.0, nats=0.0)])
    model = SimpleNamespace(out_of_model=out_of_model)
    found = SimpleNamespace(chosen=(limit,), last=last, model=model)
    part = SimpleNamespace(fisher=SimpleNamespace(columns=()))
    apart = over_time.Inconsistency("from channel to channel", excess, effect="tilt_limit", z=56.7)
    for name, known in {"_parts_of": [part] * 3, "_precision": None, "_inconsistency": apart}.items():
        monkeypatch.setattr(over_time, name, lambda *_, known=known: known)
    monkeypatch.setattr(over_time, "held_out", lambda found: SimpleNamespace(total=498.3))
    assert over_time.contradictions(found, None) == (
        {"tilt_limit": apart},
        {"tilt_limit"} if refuted else set(),
    )
