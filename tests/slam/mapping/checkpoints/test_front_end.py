"""A front end that goes on where another run was killed, to the same bits, without what has changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.packing import digest_of, pack
from slam.core.progress import silent
from slam.core.streams import Frames, Image
from slam.io.checkpoint_file import CheckpointFile
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.obstacles import Masks, no_masks
from tests.slam.small_flight import flown, only, photographs

CONFIG = PipelineConfig()


class KilledError(Exception):
    """The run ends here."""


class Killing(CheckpointFile):
    """Checkpoints of a run that is killed right behind a result."""

    def __init__(self, path: Path, after: int, said: list[str]) -> None:
        super().__init__(path, {}, say=said.append)
        self.left = after

    def keep(self, work, key, result) -> None:
        super().keep(work, key, result)
        self.left -= 1
        if self.left == 0:
            raise KilledError


@dataclass(frozen=True)
class Known:
    """Pictures that tell what they are made of, and count how often each is read."""

    pictures: list[Image | None]
    read: list[int]
    failures: dict[int, str] = field(default_factory=dict)

    def __call__(self, k: int) -> Image | None:
        self.read.append(k)
        if self.pictures[k] is None:
            self.failures[k] = "damaged"
        return self.pictures[k]

    def content_key(self, k: int) -> bytes:
        return digest_of(self.pictures[k])


@lru_cache
def recorded(is_video: bool) -> tuple[Flight, tuple[Image | None, ...]]:
    flight = only(flown(0), range(14)) if is_video else photographs([(flown(0), 4 * k) for k in range(6)])
    pictures = [flight.frames.load(k) for k in range(len(flight.frames))]
    if is_video:
        pictures[6] = pictures[5]
        pictures[9] = np.zeros_like(pictures[9])
    pictures[4] = None
    return flight, tuple(pictures)


def given(is_video: bool, change: Callable[[list[Image | None]], None] = lambda pictures: None) -> Flight:
    """The flight, read anew."""
    flight, pictures = recorded(is_video)
    load = Known(list(pictures), [])
    change(load.pictures)
    return replace(flight, frames=Frames(flight.frames.stamps_s, flight.frames.names, load, load.failures))


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    monkeypatch.setattr("slam.mapping.checkpoints.tracking.EVERY_S", 0.0)


def watched(
    flight: Flight,
    path: Path,
    after: int = -1,
    said: list[str] | None = None,
    config: PipelineConfig = CONFIG,
    masks: Masks = no_masks,
) -> Observations:
    with Killing(path, after, said if said is not None else []) as checkpoints:
        front_end = FrontEnd(flight, flight.camera, config, silent, masks=masks, checkpoints=checkpoints)
        return front_end.neighbours(front_end.track())


def content(of: Observations) -> bytes:
    """All that a front end found, as bytes."""
    stored = [of.store.digest(k) for k in range(len(of.store))]
    arrays = of.frame_index, of.stamps_s, of.frame_stamps_s, of.camera_stamps_s
    found = of.links, of.registrations, of.refused, of.passed
    counts = of.frames, dict(of.rejected), list(of.dropped.items()), of.moving, of.registered()
    return pack((stored, arrays, found, counts))


@lru_cache
def uninterrupted(is_video: bool) -> bytes:
    flight = given(is_video)
    front_end = FrontEnd(flight, flight.camera, CONFIG, silent)
    return content(front_end.neighbours(front_end.track()))


@pytest.mark.parametrize(("is_video", "after"), [(True, 7), (False, 5)])
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bits(tmp_path, is_video, after):
    path, kills = tmp_path / "checkpoint", 0
    while True:
        try:
            found = watched(given(is_video), path, after)
        except KilledError:
            kills += 1
            continue
        break
    assert content(found) == uninterrupted(is_video)
    assert kills >= 2


@pytest.mark.parametrize("is_video", [True, False])
def test_what_is_known_is_not_computed_again(tmp_path, is_video):
    path, said = tmp_path / "checkpoint", []
    watched(given(is_video), path)
    size, flight = path.stat().st_size, given(is_video)
    assert content(watched(flight, path, said=said)) == uninterrupted(is_video)
    assert flight.frames.load.read in ([], [4]), "a picture that was unreadable may be readable now"
    assert path.stat().st_size == size
    first = "all of 14 pictures are tracked" if is_video else "5 of 6 photographs are searched"
    assert said[0].startswith(f"resumed: {first}")
    assert "pairs of pictures are compared" in said[1]


@pytest.mark.parametrize("is_video", [True, False])
def test_a_picture_that_has_changed_is_looked_at_again(tmp_path, is_video):
    path, said, changed = tmp_path / "checkpoint", [], 11 if is_video else 2

    def change(pictures: list[Image | None]) -> None:
        pictures[changed] = np.ascontiguousarray(pictures[changed][::-1])

    watched(given(is_video), path)
    flight = given(is_video, change)
    resumed = content(watched(flight, path, said=said))
    assert resumed == content(watched(given(is_video, change), tmp_path / "none"))
    assert resumed != uninterrupted(is_video)
    if is_video:
        assert 2 not in flight.frames.load.read
        assert "pictures behind number" in said[0]
    else:
        assert set(flight.frames.load.read) == {2, 4}


def test_pairs_are_known_by_other_numbers_of_their_keyframes(tmp_path):
    def without_first(pictures: list[Image | None]) -> None:
        pictures[0] = None

    said: list[str] = []
    watched(given(False), tmp_path / "checkpoint")
    resumed = content(watched(given(False, without_first), tmp_path / "checkpoint", said=said))
    assert any("pairs of pictures are compared" in line for line in said)
    assert resumed == content(watched(given(False, without_first), tmp_path / "none"))


FEWER = replace(CONFIG, features=replace(CONFIG.features, max_features=150))
STRICTER = replace(CONFIG, gates=replace(CONFIG.gates, min_inliers=CONFIG.gates.min_inliers + 1))


def half(frame: int) -> Image:
    """A mask that lets the upper half of a picture be used."""
    width, height = recorded(False)[0].camera.size_px
    mask = np.zeros((height, width), np.uint8)
    mask[: height // 2] = 255
    return mask


@pytest.mark.parametrize(
    ("is_video", "config", "masks", "known"),
    [
        (True, STRICTER, no_masks, []),
        (False, STRICTER, no_masks, ["photographs are searched"]),
        (False, FEWER, no_masks, []),
        (False, CONFIG, half, []),
    ],
)
def test_only_results_of_the_same_settings_and_masks_are_known(tmp_path, is_video, config, masks, known):
    path, said = tmp_path / "checkpoint", []
    watched(given(is_video), path)
    watched(given(is_video), path, said=said, config=config, masks=masks)
    assert [" ".join(line.split()[-3:]) for line in said] == known


def test_other_readings_track_a_video_anew(tmp_path):
    path, said = tmp_path / "checkpoint", []
    watched(given(True), path)
    flight = given(True)
    watched(replace(flight, sonar=replace(flight.sonar, noise_std_m=0.5)), path, said=said)
    assert not any("tracked" in line for line in said)


class KnownUpTo(Known):
    """Pictures of which the last ones do not tell what they are made of."""

    def content_key(self, k: int) -> bytes | None:
        return None if k >= 11 else super().content_key(k)


def test_pictures_of_unknown_content_are_never_resumed(tmp_path):
    flight = given(True)
    for load in (lambda k: recorded(True)[1][k], KnownUpTo(list(recorded(True)[1]), [])):
        path, said = tmp_path / type(load).__name__, []
        blind = replace(flight, frames=replace(flight.frames, load=load))
        watched(blind, path)
        watched(blind, path, said=said)
        assert not any("all of" in line for line in said)
    assert any("the first" in line for line in said)
    assert 11 in load.read[-10:]
