"""Which of several cameras looks down, by their pictures: when it is asked, decided and told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frontend.camera import Camera
from slam.io.down_looking import Look
from slam.io.recordings.camera_views import ODDS, CameraLook, is_decisive, judged, signed_rank_chance
from slam.io.recordings.recording import Offer, Recording

CAMERA = Camera(focal_px=(5.0, 5.0), center_px=(2.5, 1.5), size_px=(6, 4))


def camera(channel: str, look: Look = Look.UNKNOWN, **more) -> Offer:
    return Offer(stream="cam0", channel=channel, kind="Image", rows=9, reading="", look=look, **more)


def recording(*offers: Offer) -> tuple[Recording, list[str]]:
    """A recording that notes whose pictures are asked for, and shows none of them."""
    asked: list[str] = []

    def watch(offer, alone):
        if not alone:
            asked.append(offer.channel)
        return CAMERA, ()

    return Recording(
        path=Path("a.bag"), name="a", description="a bag", offers=offers, read=lambda *_: None, watch=watch
    ), asked


def silent(*_):
    pass


@pytest.mark.parametrize(
    ("offers", "topics", "expected"),
    [
        ((camera("/a"), camera("/b")), {}, ["/a", "/b"]),
        ((camera("/a"), camera("/b")), {"cam0": "/b"}, []),
        ((camera("/a"),), {}, ["/a"]),
        ((camera("/a", is_declared=True),), {}, []),
        ((camera("/a", Look.DOWN),), {}, []),
        ((camera("/a"), camera("/b", Look.DOWN)), {}, []),
        ((camera("/a"), camera("/b", Look.ASIDE)), {}, ["/a"]),
        ((camera("/a", Look.ASIDE), camera("/b", Look.ASIDE)), {}, ["/a", "/b"]),
        ((camera("/a", Look.ASIDE, is_declared=True), camera("/b", Look.ASIDE, is_declared=True)), {}, []),
        ((camera("/a/x", device="/a", rank=1), camera("/a/y", device="/a")), {}, ["/a/y"]),
        ((camera("/a/x", device="/a", rank=1), camera("/a/y", device="/a"), camera("/b")), {}, None),
    ],
)  # fmt: skip
def test_pictures_are_asked_only_where_nothing_else_tells(offers, topics, expected):
    made, asked = recording(*offers)
    judged(made, topics, silent)
    assert asked == (expected if expected is not None else ["/a/y", "/b"]), "one channel of each device"


def test_where_pictures_do_not_tell_the_option_is_named():
    made, _ = recording(camera("/a"), camera("/b"))
    known = judged(made, {}, silent)
    (line,) = map(str, known.remarks("/a"))
    assert "which of /a and /b looks down" in line
    assert "--topic cam0=CHANNEL" in line
    assert known.remarks(None) == []
    single = judged(recording(camera("/a"))[0], {}, silent)
    assert single.remarks("/a") == [], "the missing transform is warned of as before"
    assert all("no gyro or attitude" in offer.view for offer in known.recording.offers)


def test_a_direction_is_said_with_its_evidence():
    clear = np.full(20, 30.0)
    found = CameraLook.of(clear, np.radians(4.2), "down", "straight down", "its turns")
    assert (found.look, found.tilt_deg) == (Look.DOWN, pytest.approx(4.2))
    assert found.sentence == "looks down, 4 degrees from straight down, by its turns in 20 stretches"
    found = CameraLook.of(-clear, np.radians(88.0), "down", "straight down", "its turns")
    assert found.look == Look.ASIDE
    assert found.sentence.startswith("looks aside, 88 degrees")
    assert CameraLook.of(0.01 * clear, 0.0, "down", "straight down", "its turns").look == Look.UNKNOWN


def test_evidence_must_be_large_and_agree():
    least = 2.0 * np.log(ODDS)
    alike = np.linspace(0.9, 1.1, 12) / 12
    assert is_decisive(1.01 * least * alike)
    assert not is_decisive(0.99 * least * alike), "the odds are too small"
    assert not is_decisive(-10 * least * alike), "it is for the other one"
    assert not is_decisive([1000.0, *[0.0] * 11]), "one stretch alone decides"
    assert not is_decisive([300.0, -200.0] * 6), "the stretches contradict each other"
    assert is_decisive([1e4, *(10 * least * alike)]), "one stretch that tells more does no harm"


def test_the_chance_of_signed_ranks_is_wilcoxon_s():
    from scipy.stats import wilcoxon

    rng = np.random.default_rng(2)
    for shift in (-1.0, 0.0, 0.5, 2.0):
        differences = rng.normal(shift, 1.0, 14)
        expected = wilcoxon(differences, alternative="greater", method="exact").pvalue
        assert signed_rank_chance(differences) == pytest.approx(expected, rel=1e-9)
    assert signed_rank_chance(np.array([3.0, 0.0])) == 0.5
    assert signed_rank_chance(np.zeros(3)) == 1.0


def test_chance_decides_once_in_a_thousand():
    """Of two equally good explanations, noise with outliers decides no more often than the odds say."""
    rng = np.random.default_rng(1)
    decided = sum(is_decisive(rng.standard_t(1, 12)) for _ in range(1000))
    assert decided <= 5  # 1 is expected; more than 5 has a chance of 0.06 %
