"""Every number among the settings has a range, and what lies outside is refused by name."""

from __future__ import annotations

from dataclasses import fields
from typing import get_type_hints

import pytest

from slam.core.errors import InputError
from slam.core.toml_config import load_config
from slam.mapping.config import PipelineConfig

NUMBERS = [
    (section, key)
    for section, part in get_type_hints(PipelineConfig).items()
    for key in (f.name for f in fields(part))
    if type(getattr(part(), key)) in (int, float)
]


def test_the_defaults_are_within_their_ranges():
    given = {
        section: {f.name: getattr(part(), f.name) for f in fields(part)}
        for section, part in get_type_hints(PipelineConfig).items()
    }
    assert load_config(PipelineConfig, given, "settings.toml") == PipelineConfig()


@pytest.mark.parametrize(("section", "key"), NUMBERS)
def test_a_number_that_means_nothing_is_refused_by_name(section, key):
    for nonsense in (-1, float("nan"), float("inf"), 1e12, 10**400, "x"):
        with pytest.raises(InputError, match=rf"{section}\.{key}"):
            load_config(PipelineConfig, {section: {key: nonsense}}, "settings.toml")


@pytest.mark.parametrize("grids", [[], [[0, 6]], [[8]]])
def test_a_grid_without_cells_is_refused(grids):
    with pytest.raises(InputError, match=r"tracks\.grids"):
        load_config(PipelineConfig, {"tracks": {"grids": grids}}, "settings.toml")
