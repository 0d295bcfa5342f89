"""Tests of which freed memory goes back to the system."""

import platform
import resource
import subprocess
import sys

import pytest

from slam.core.heap import large_blocks_kept, map_large_blocks

_BLOCK_BYTES, _TIMES = 2**20, 20
_PAGES = _TIMES * _BLOCK_BYTES // resource.getpagesize()


def _pages_given() -> int:
    """Return how many pages the system gives for blocks that are freed one after the other."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(_TIMES):
        block = b"x" * _BLOCK_BYTES
        del block
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings are those of the GNU C library")
def test_large_blocks_are_reused_in_the_block_alone():
    """In a process of its own: a hole that other tests leave in the heap would take the blocks."""
    check = "from tests.slam.core.test_heap import check_reuse; check_reuse()"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def check_reuse() -> None:
    """Raise ``AssertionError`` where blocks are reused outside of `large_blocks_kept`, or are not inside."""
    map_large_blocks()
    assert _pages_given() > 0.9 * _PAGES
    with large_blocks_kept():
        assert _pages_given() < 0.2 * _PAGES
    assert _pages_given() > 0.9 * _PAGES
