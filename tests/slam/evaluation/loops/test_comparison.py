"""``slam loops`` on small flights: what must be found, what must fall, what is refused in one line."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from backend.measurements import LinkCheck, Rejection
from frontend.registration import refused
from slam.cli import app
from slam.cli.output_folder import LOOPS_NAMES
from slam.core.errors import InputError
from slam.core.estimate import LoopVerdict
from slam.core.flight import Flight
from slam.core.messages import unread
from slam.core.plot_style import png
from slam.evaluation.loops import LoopEvaluation, evaluate_loops
from slam.evaluation.loops.comparison import (
    EXHAUSTIVE,
    HISTOGRAM,
    OURS,
    WORDS,
    most_alike,
    score_exhaustive,
    score_method,
    stages_of,
)
from slam.evaluation.loops.reference import FALSE, TRUE, UNDECIDED, Reference
from slam.io.flight_folder import write_flight
from slam.mapping.front_end import Observations
from tests.slam.small_flight import flown, gps_of, only

LAPS = {"cruise_m_s": 0.5, "way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], "A"], "laps": 3}
LIGHT = {"exposure_variation": {"gain": 0.15, "gamma": 0.3, "tau": 0.02}}
NO_ROWS = unread("data.csv has no rows", "treated as not recorded").named("cam0")
ALIASED = {"repeat": True, "tile_m": 1.2, "extent_m": [0, 0, 1.8, 1.2], "seed": 3}


@lru_cache(maxsize=4)
def flight(aliased: bool = False) -> Flight:
    world = {"mark_diameter_m": 0.0, **(ALIASED if aliased else {})}
    # Two laps meet every place again; a third makes twice as many pairs of them.
    laps = {**LAPS, "laps": 2} if aliased else LAPS
    return flown(maneuver=laps, world=world, camera={"rate_hz": 5.0}, terms=LIGHT)


@lru_cache(maxsize=4)
def evaluated(aliased: bool = False) -> LoopEvaluation:
    return evaluate_loops(flight(aliased))


def by_name(evaluation: LoopEvaluation) -> dict:
    return {method.name: method for method in evaluation.methods}


@pytest.mark.slow
def test_laps_over_one_floor_are_recognised_and_ours_is_above_the_baselines():
    result = evaluated()
    methods = by_name(result)
    assert list(methods) == [OURS, HISTOGRAM, WORDS, EXHAUSTIVE]
    chance = result.true_pairs / result.pairs
    ours = methods[OURS]
    assert 0.1 < chance < 0.6
    assert ours.candidates.area > max(0.8, methods[HISTOGRAM].candidates.area)
    assert methods[HISTOGRAM].candidates.area > chance
    assert methods[WORDS].candidates.area > chance + 0.1
    ceiling = methods[EXHAUSTIVE]
    assert ceiling.candidates is None
    assert ceiling.after_verification.area > 0.95
    for method in methods.values():
        assert method.verified.true <= method.proposed.true <= result.true_pairs
        assert method.after_verification.area <= ceiling.after_verification.area + 1e-9
    stages = [stage.counts for stage in result.stages]
    assert stages[-1].false == 0
    assert stages[-1].true > 0.9 * result.all_true_pairs
    assert all(a.true >= b.true and a.false >= b.false for a, b in pairwise(stages))


@pytest.mark.slow
def test_on_a_floor_that_repeats_false_loops_pass_verification_and_none_reaches_the_map():
    result = evaluated(aliased=True)
    registered, reached = by_name(result)[OURS].verified, result.stages[-1].counts
    assert registered.false > 0.3 * registered.true
    assert by_name(result)[EXHAUSTIVE].after_verification.full_precision_recall < 0.5
    assert result.stages[1].counts.false > 0
    assert reached.false == 0
    assert reached.true > 0.5 * result.all_true_pairs


def made(seed: int = 0) -> tuple[np.ndarray, ...]:
    """Pairs of 40 keyframes on a line, labels, a good likeness, inliers of all but false pairs."""
    rng = np.random.default_rng(seed)
    i, j = np.triu_indices(40, 1)
    gap = j - i
    labels = np.where(gap < 6, TRUE, np.where(gap < 9, UNDECIDED, FALSE))
    likeness = np.exp(-gap / 8) + rng.normal(0, 0.02, len(gap))
    return np.column_stack([i, j]), labels, likeness, np.where(labels == FALSE, 0.0, 90.0 - gap)


def test_a_retrieval_that_is_shuffled_falls_to_chance():
    pairs, labels, likeness, inliers = made()
    good = score_method("good", likeness, inliers, pairs, labels, 6)
    shuffled = np.random.default_rng(1).permutation(likeness)
    bad = score_method("bad", shuffled, inliers, pairs, labels, 6)
    chance = (labels == TRUE).sum() / (labels != UNDECIDED).sum()
    assert good.candidates.area > 0.97
    assert bad.candidates.area == pytest.approx(chance, abs=0.08)
    assert bad.after_verification.area < 0.6 * good.after_verification.area
    assert bad.verified.false == 0, "verification holds back what retrieval gets wrong"
    assert bad.verified.true < 0.6 * good.verified.true
    every = score_exhaustive(inliers, labels)
    assert every.after_verification.area == 1.0
    assert every.verified.true == (labels == TRUE).sum()


def test_undecided_pairs_count_neither_way():
    pairs, labels, likeness, inliers = made()
    decided = labels != UNDECIDED
    all_of_them = score_method("", likeness, inliers, pairs, labels, 50)
    without = score_method("", likeness[decided], inliers[decided], pairs[decided], labels[decided], 50)
    assert all_of_them.candidates.area == without.candidates.area
    assert all_of_them.after_verification.area == without.after_verification.area


def test_the_most_alike_are_each_ones_own():
    rng = np.random.default_rng(4)
    pairs = np.array([(i, j) for j in range(12) for i in range(j) if j - i > 2])
    likeness = rng.random(len(pairs))
    expected = set()
    for k in range(12):
        mine = [m for m, pair in enumerate(pairs.tolist()) if k in pair]
        expected |= set(sorted(mine, key=lambda m: -likeness[m])[:3])
    assert set(np.flatnonzero(most_alike(likeness, pairs, 3))) == expected


def test_each_candidate_is_counted_up_to_the_stage_that_rejected_it():
    """Whatever the words: a gate says "implausible change of scale", and the graph that an edge agrees."""
    far, gated = refused(0, 20, Rejection(LinkCheck.REACH, "9 m")), refused(1, 21, Rejection(LinkCheck.SCALE))
    held = replace(refused(2, 22, Rejection(LinkCheck.OTHER)), matches=np.ones((20, 2), np.int32))
    observations = Observations(
        store=None, frame_index=np.arange(40), stamps_s=np.arange(40.0), links=(None,) * 40,
        registrations=(held,), refused=(far, gated), frames=40, rejected=Counter(),
    ).without({(2, 22): Rejection(LinkCheck.PLACE, "3 m from where the poses put it")})  # fmt: skip
    verdicts = [LoopVerdict(r.i, r.j, r.reason) for r in observations.refused]
    verdicts += [
        LoopVerdict(3, 23, Rejection(LinkCheck.KNOWN_PLACE)),
        LoopVerdict(4, 24, Rejection(LinkCheck.GRAPH, "9.0 sigma")),
        LoopVerdict(5, 25, None),
    ]
    nowhere = Reference("truth", np.arange(40.0), np.zeros((40, 2)), {})
    stages = stages_of(verdicts, observations, nowhere)
    assert [stage.counts.false for stage in stages] == [6, 5, 4, 3, 1]


@pytest.mark.slow
def test_gps_serves_where_there_is_no_truth():
    with_gps = replace(flight(), truth=None, gps=gps_of(flight(), 0.01))
    result = evaluate_loops(with_gps)
    assert result.reference.kind == "gps"
    assert 0.001 < result.reference.position_std_m < 0.05
    assert result.stages[-1].counts.false == 0
    assert by_name(result)[OURS].candidates.area > 0.8
    told = evaluated().reference
    pairs = result.reference.eligible(np.arange(result.keyframes))
    ours, theirs = result.reference.labels(pairs), told.labels(pairs)
    sure = (ours != UNDECIDED) & (theirs != UNDECIDED)
    assert sure.mean() > 0.5
    assert (ours[sure] == theirs[sure]).all()


@pytest.mark.parametrize(
    ("spoil", "saying"),
    [
        (lambda f: replace(f, truth=None), "neither truth nor GPS"),
        (lambda f: replace(f, camera=None, frames=None), "no camera in this flight"),
        (lambda f: replace(f, camera=None, frames=None, messages=(NO_ROWS,)), "cam0: data.csv has no rows"),
        (lambda f: only(f, range(12)), "too few for a loop"),
        (lambda f: only(f, [0]), "a map needs two pictures"),
    ],
)
def test_what_cannot_be_judged_is_refused_in_one_line(spoil, saying):
    with pytest.raises(InputError, match=saying) as refusal:
        evaluate_loops(spoil(flight()))
    assert "\n" not in str(refusal.value)


def test_the_command_writes_its_files_and_a_table(tmp_path, monkeypatch):
    drawn: list[Figure] = []
    monkeypatch.setattr(
        "slam.evaluation.loops.figure.png", lambda figure: drawn.append(figure) or png(figure)
    )
    two_laps = 2 * len(flight().frames) // 3
    write_flight(only(flight(), range(0, two_laps, 3)), tmp_path / "flight")
    out = tmp_path / "out"
    wide = {"COLUMNS": "160"}  # no name in the table is folded
    run = CliRunner().invoke(app, ["loops", str(tmp_path / "flight"), "--out", str(out)], env=wide)
    assert run.exit_code == 0, run.output
    assert {path.name for path in out.iterdir()} == set(LOOPS_NAMES)
    assert re.search(r"bag of words +[01](\.\d{3})?", run.stdout)
    assert re.search(r"our map +\d+ of \d+ / \d+", run.stdout)
    assert "Recall at full precision: share of all true loops" in " ".join(run.stdout.split())
    summary, record = (json.loads((out / name).read_text()) for name in ("summary.json", "loops.json"))
    assert summary["status"] == "ok"
    assert summary["methods"] == record["methods"]
    curve = record["curves"][OURS]["candidates"]
    assert len(curve["recall"]) == len(curve["precision"]) == len(curve["threshold"]) <= 200
    assert curve["recall"] == sorted(curve["recall"])
    assert (out / "loops.png").read_bytes().startswith(b"\x89PNG")
    # Counts stand on an axis of plain numbers.
    assert {"0", "10"} <= {tick.get_text() for tick in drawn[0].axes[2].get_xticklabels()}
    again = CliRunner().invoke(app, ["loops", str(tmp_path / "gone"), "--out", str(out)])
    assert again.exit_code == 1
    assert re.fullmatch(r"slam: [^\n]*does not exist[^\n]*\n", again.stderr)
    assert {path.name for path in out.iterdir()} == set(LOOPS_NAMES)
