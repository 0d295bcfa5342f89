from __future__ import annotations

import errno
import os
from pathlib import Path

import numba
import numpy as np

from backend.compilation import compiling, discard_stale, kernel, njit


def made(folder: Path, name: str, source_s: float, cached_s: float) -> Path:
    (folder / "__pycache__").mkdir(exist_ok=True)
    source = folder / f"{name}.py"
    for path, stamp in ((source, source_s), (folder / "__pycache__" / f"{name}.run-3.py311.nbi", cached_s)):
        path.write_text("x")
        os.utime(path, (stamp, stamp))
    return source


def left(folder: Path) -> set[str]:
    return {path.name.split(".")[0] for path in (folder / "__pycache__").iterdir()}


def test_all_goes_where_one_source_is_newer(tmp_path):
    sources = [made(tmp_path, "calls", 100, 200), made(tmp_path, "called", 300, 250)]
    bystander = made(tmp_path, "calls_not", 100, 150)
    assert discard_stale(sources) == 2
    assert left(tmp_path) == {bystander.stem}


def test_nothing_goes_where_all_is_fresh(tmp_path):
    sources = [made(tmp_path, "calls", 100, 200), made(tmp_path, "called", 150, 250)]
    assert discard_stale(sources) == 0
    assert left(tmp_path) == {"calls", "called"}


def test_where_nothing_can_be_cached_kernels_work_all_the_same(monkeypatch):
    """As in an installation that is read-only, of a user without a home."""
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])

    @njit(cache=True, nogil=True)
    def twice(x):
        return 2 * x

    assert twice(4) == 8
    assert twice.targetoptions["nogil"]


def test_a_full_disk_of_the_cache_costs_no_result(monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(numba.core.caching.IndexDataCacheFile, "save", full)

    @njit(cache=True)
    def thrice(x):
        return 3 * x

    assert thrice(4) == 12


def test_sources_that_were_never_compiled_are_no_trouble(tmp_path):
    source = tmp_path / "new.py"
    source.write_text("")
    assert discard_stale([source]) == 0


def test_what_is_compiled_is_told_once_with_all_that_it_calls_and_not_again():
    @njit()
    def inner(x):
        return 2 * x

    @njit()
    def outer(x):
        return inner(x) + 1

    told: list[bool] = []
    with compiling(told.append):
        assert outer(3) == 7
        assert told == [False, True]
        outer(4)
    outer(4.5)
    assert told == [False, True]


def test_a_kernel_rounds_as_its_source_says():
    """Where it may reorder sums, its result depends on how it is compiled: alone or into its caller."""

    @kernel
    def product_of(x, y):
        total = 0.0
        for i in range(len(x)):
            total += x[i] * y[i]
        return total

    x, y = np.random.default_rng(1).standard_normal((2, 1000))
    in_order = 0.0
    for one, other in zip(x.tolist(), y.tolist(), strict=True):
        in_order += one * other
    assert product_of(x, y) == in_order
