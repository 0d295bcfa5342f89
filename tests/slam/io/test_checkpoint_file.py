"""The file of results for a later run: whole after a kill, and never used where it does not fit."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from slam.io.checkpoint_file import CheckpointFile

RUN = {"the program": "a", "the settings": "b"}
KEYS = [bytes([k]) * 16 for k in range(3)]


def written(path: Path) -> list[bytes]:
    results = [b"first", b"", b"third"]
    with CheckpointFile(path, RUN) as file:
        for key, result in zip(KEYS, results, strict=True):
            file.keep("pair", key, result)
    return results


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "checkpoint"


def recalled(path: Path, said: list[str] | None = None) -> list[bytes | None]:
    with CheckpointFile(path, RUN, say=(said if said is not None else []).append) as file:
        return [file.recall("pair", key) for key in KEYS]


def test_results_are_known_to_the_next_run_by_work_and_key(path):
    results = written(path)
    assert recalled(path) == results
    with CheckpointFile(path, RUN) as file:
        assert file.recall("track", KEYS[0]) is None
        file.keep("pair", KEYS[0], b"later")
        assert file.recall("pair", KEYS[0]) == b"later"
    assert recalled(path)[0] == b"later"


def test_a_kill_at_any_byte_leaves_the_results_before(path):
    results = written(path)
    whole = path.read_bytes()
    for size in range(0, len(whole), 3):
        path.write_bytes(whole[:size])
        found = recalled(path)
        count = sum(each is not None for each in found)
        assert found == results[:count] + [None] * (3 - count), size
    path.write_bytes(whole + whole[len(whole) // 2 :])
    with CheckpointFile(path, RUN) as file:
        assert path.stat().st_size == len(whole), "a record that is cut off is removed"
        file.keep("pair", KEYS[2], b"again")
    assert recalled(path) == [*results[:2], b"again"]


def test_a_flipped_bit_costs_what_it_is_in(path):
    results = written(path)
    whole = bytearray(path.read_bytes())
    for at in range(0, len(whole), 7):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        said: list[str] = []
        found = recalled(path, said)
        assert all(each in (None, result) for each, result in zip(found, results, strict=True)), at
    path.write_bytes(whole[:-2] + b"\0" + whole[-1:])
    said = []
    assert recalled(path, said) == [*results[:2], None]
    assert "damaged" in said[0]


def test_another_run_starts_anew_and_says_what_changed(path):
    written(path)
    said: list[str] = []
    with CheckpointFile(path, RUN | {"the settings": "c"}, say=said.append) as file:
        assert [file.recall("pair", key) for key in KEYS] == [None] * 3
    assert said == ["starts anew: since the run that was ended, the settings changed"]


def test_without_resume_nothing_is_known(path):
    written(path)
    with CheckpointFile(path, RUN, resume=False) as file:
        assert [file.recall("pair", key) for key in KEYS] == [None] * 3
    assert not path.exists(), "it holds nothing"


def test_a_full_disk_ends_the_checkpoints_alone(path, monkeypatch):
    said: list[str] = []
    with CheckpointFile(path, RUN, say=said.append) as file:
        file.keep("pair", KEYS[0], b"x" * 1000)
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        monkeypatch.setattr(os, "pwrite", lambda *given: (_ for _ in ()).throw(full))
        file.keep("pair", KEYS[1], b"x")
        file.keep("pair", KEYS[2], b"x")
        assert not file.are_kept
        assert file.recall("pair", KEYS[0]) is None
    assert not path.exists(), "its disk is given back, and nothing of it can be resumed"
    (line,) = said
    assert "full" in line


def test_a_disk_that_refuses_everything_does_not_end_the_run(path, monkeypatch):
    def refused(*given):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    said: list[str] = []
    with CheckpointFile(path, RUN, say=said.append) as file:
        for name in ("pwrite", "ftruncate", "unlink"):
            monkeypatch.setattr(os, name, refused)
        file.keep("pair", KEYS[0], b"x")
        assert not file.are_kept
    assert "fault" in said[0]


def test_a_link_is_not_followed(path, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.write_text("theirs")
    path.symlink_to(theirs)
    said: list[str] = []
    with CheckpointFile(path, RUN, say=said.append) as file:
        file.keep("pair", KEYS[0], b"ours")
    assert theirs.read_text() == "theirs"
    assert path.is_symlink()
    assert "no checkpoints" in said[0]
