"""Features of all keyframes on disk and back."""

from __future__ import annotations

import errno
import gc
import os
import tempfile
import tracemalloc
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from frontend.features import Features
from frontend.points import Points
from frontend.store import FeatureStore


def made(rng: np.random.Generator, n: int, binary: bool) -> Features:
    descriptor = (
        rng.integers(0, 256, (n, 61), dtype=np.uint8)
        if binary
        else rng.normal(size=(n, 128)).astype(np.float32)
    )
    return Features(Points(rng.uniform(0, 300, (n, 2)), rng.uniform(1, 2, n)), descriptor)


@pytest.mark.parametrize("binary", [False, True])
def test_what_goes_in_comes_out_in_any_order(binary: bool) -> None:
    rng = np.random.default_rng(0)
    kept = [made(rng, n, binary) for n in (0, 5, 300, 0, 1, 77, 0)]
    store = FeatureStore()
    for k, features in enumerate(kept):
        assert len(store) == k
        store.append(features)
    for k in rng.permutation(7):
        back = store[k]
        assert back.descriptor.dtype == kept[k].descriptor.dtype
        np.testing.assert_array_equal(back.descriptor, kept[k].descriptor)
        np.testing.assert_array_equal(back.pixel, kept[k].pixel)
        np.testing.assert_array_equal(back.points.spread, kept[k].points.spread)
        np.testing.assert_array_equal(store.points[int(k)].pixel, kept[k].pixel)
    assert [len(p) for p in store.points] == [0, 5, 300, 0, 1, 77, 0]


def test_descriptors_that_are_a_view_of_something_larger_are_kept_right() -> None:
    rng = np.random.default_rng(1)
    whole = made(rng, 40, False)
    store = FeatureStore()
    store.append(whole[np.arange(0, len(whole), 2)])
    np.testing.assert_array_equal(store[0].descriptor, whole.descriptor[::2])


def test_a_system_that_takes_a_part_of_each_write_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, rng, store = os.pwrite, np.random.default_rng(4), FeatureStore()
    monkeypatch.setattr(os, "pwrite", lambda file, data, offset: whole(file, data[:1000], offset))
    kept = [made(rng, 50, False) for _ in range(3)]
    for features in kept:
        store.append(features)
    for k in range(3):
        np.testing.assert_array_equal(store[k].descriptor, kept[k].descriptor)


def test_threads_read_without_disturbing_each_other() -> None:
    rng = np.random.default_rng(2)
    kept = [made(rng, 200, True) for _ in range(20)]
    store = FeatureStore()
    for features in kept:
        store.append(features)
    asked = rng.integers(0, 20, 400)
    with ThreadPoolExecutor(4) as pool:
        for k, back in zip(asked, pool.map(store.__getitem__, asked.tolist()), strict=True):
            np.testing.assert_array_equal(back.descriptor, kept[k].descriptor)


def test_features_take_no_memory_and_the_file_goes_with_the_store() -> None:
    """The file has no name: whatever ends the program, nothing is left behind."""
    rng = np.random.default_rng(3)
    store = FeatureStore()
    tracemalloc.start()
    for _ in range(10):
        store.append(made(rng, 500, False))
    gc.collect()
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    descriptor = store._file.fileno()
    size = 10 * 500 * (24 + 128 * 4)
    assert os.fstat(descriptor).st_size == size
    assert os.fstat(descriptor).st_nlink == 0
    assert held < 0.01 * size
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # ResourceWarning
        del store
        gc.collect()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)


@pytest.mark.parametrize("call", ["pwrite", "pread"])
def test_errors_of_the_system_name_the_folder_of_temporary_files(monkeypatch, call: str) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store, features = FeatureStore(), made(np.random.default_rng(0), 5, True)
    store.append(features)
    monkeypatch.setattr(os, call, full)
    with pytest.raises(OSError, match="No space") as caught:
        store.append(features) if call == "pwrite" else store[0]
    assert caught.value.filename == tempfile.gettempdir()


def test_a_machine_without_room_for_temporary_files_is_reported(monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", list)
    monkeypatch.setenv("TMPDIR", "/full")
    with pytest.raises(OSError, match="No space") as caught:
        FeatureStore()
    assert caught.value.filename == "/full"
