"""Candidates for the next term, fitted before one is chosen."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from slam.core.progress import Tally, silent
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import ScoreTest
from slam.criticism.search.fitting import best_candidate


def test_by_how_much_a_candidate_that_is_beaten_falls_behind_is_kept(monkeypatch):
    """A look from the healthy vehicle does not tell what another term does in the chosen one's place."""
    nats = {"ground_effect": 90.0, "sonar_bias": 60.0, "sonar_slant": 89.0}
    fits = {None: 0.0} | nats

    def refit(records, model, parameters, effects):
        return fits[effects[-1].name if effects else None], parameters

    monkeypatch.setattr("slam.criticism.search.fitting.refit", refit)
    candidates = [Effect(name, relaxes=(name,)) for name in nats]
    expansion = SimpleNamespace(model=None, parameters=None)

    ranked = [ScoreTest(e, nats[e.name], 12.0) for e in candidates]
    found = best_candidate([], expansion, [], ranked, Tally(silent, "compare causes"))
    assert (found.effect.name, found.rivals) == ("ground_effect", ("sonar_slant",))
    leads = {other: lead for (_, other), lead in found.leads.items()}
    assert leads == pytest.approx({candidates[1].label: 30.0, candidates[2].label: 1.0})
