"""What tests of maps and reports share."""

from __future__ import annotations

import pytest

DRAWN = ("report.pictures.path", "report.pictures.path_over_time", "evaluation.plots")


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave figures empty where a test looks at what stands beside them: drawing them takes the longest.

    Tests without this fixture draw each of them.
    """
    for module in DRAWN:
        monkeypatch.setattr(f"slam.{module}.png", lambda *_, **__: b"")
