"""The blind camera: a healthy one shows the floor where it is, and whatever is wrong with it shows."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.camera import FOCAL_PX, HEIGHT, MIDDLE, PIECE_M, PIECES, WIDTH, Camera, floor, pictures
from tests.blind.cases import PICTURED, Outing, make
from tests.blind.faults import BY_NAME, FAULTS, FURTHER, SEEN, SEEN_STRANGE, STRANGE, STRANGER, Fault
from tests.blind.instruments import moments
from tests.blind.vehicle import HEALTHY

OUTING = Outing(3, 0, ("square",), 6.0)
SHOWN = [f for f in (*SEEN, *SEEN_STRANGE) if f.name not in ("flow_derotation", "dropped_frames")]


@cache
def ground() -> NDArray[np.float32]:
    return floor(np.random.default_rng(2))


def shown(path, seed: int = 4) -> list[NDArray[np.uint8]]:
    shots = pictures(path, 0, ground(), np.random.default_rng(seed))
    return [cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for _, jpeg in shots]


@cache
def healthy() -> list[NDArray[np.uint8]]:
    return shown(OUTING.fly([(0, HEALTHY)], 0.005, restless=True))


def test_the_floor_has_no_edge() -> None:
    """Where it begins anew it changes no more than anywhere else."""
    levels = ground()
    across = np.abs(levels[:, 0] - levels[:, -1]).mean()
    assert across == pytest.approx(np.abs(np.diff(levels, axis=1)).mean(), rel=0.25)


def test_a_point_of_the_floor_is_seen_where_a_pinhole_sees_it() -> None:
    path = OUTING.fly([(0, HEALTHY)], 0.005, restless=True)
    for t in (1.0, 3.3, 5.1):
        m = moments(path, 0, np.array([t]))
        mark_m = m.place[0, :2] + [0.11, -0.07]
        blank = np.zeros((PIECES, PIECES, 3), np.float32)
        column, row = np.rint(np.mod(mark_m / PIECE_M, PIECES)).astype(int) % PIECES
        # Columns of the floor go along x.
        near = (np.arange(middle - 3, middle + 4) % PIECES for middle in (row, column))
        blank[np.ix_(*near)] = 200.0
        light = Camera(HEALTHY, blank, []).exposed(path, 0, t)[..., 0]
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        found = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
        forward, left, up = m.w_R_b[0].inv().apply(np.append(mark_m, 0.0) - m.place[0])
        due = MIDDLE + FOCAL_PX * np.array([-left, -forward]) / -up
        np.testing.assert_allclose(found, due, atol=0.5)


@pytest.mark.parametrize(
    "fault",
    [pytest.param(f, id=f.name, marks=() if k % 24 == 0 else pytest.mark.slow) for k, f in enumerate(SHOWN)],
)
def test_whatever_is_wrong_shows(fault: Fault) -> None:
    """Far beyond what noise and compression leave of pictures that are else the same."""
    knobs = {**HEALTHY, **fault.apply(fault.high, dict(HEALTHY), np.random.default_rng(1))}
    with_it = shown(OUTING.fly([(0, knobs)], 0.005, restless=True))
    apart = [np.abs(a.astype(float) - b).mean() for a, b in zip(with_it, healthy(), strict=True)]
    assert max(apart) > 1.5


@pytest.mark.slow
def test_pictures_are_lost_in_their_share() -> None:
    path = OUTING.fly([(0, {**HEALTHY, "lost": 0.1})], 0.005, restless=True)
    kept = sum(len(shown(path, seed)) for seed in range(12))
    assert kept / (12 * len(shown(OUTING.fly([(0, HEALTHY)], 0.005, True)))) == pytest.approx(0.9, abs=0.05)


def test_pictures_are_what_their_seed_says_and_neither_dark_nor_flat() -> None:
    path = OUTING.fly([(0, HEALTHY)], 0.005, restless=True)
    one, other, third = healthy(), shown(path, 4), shown(path, 5)
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[0], third[0])
    assert one[0].shape == (HEIGHT, WIDTH, 3)
    assert 60.0 < np.mean(one) < 190.0
    assert np.std(one) > 15.0


@pytest.mark.slow
def test_folders_of_sound_and_faulty_cameras_look_alike(tmp_path: Path) -> None:
    for kind, fault in zip(PICTURED, (None, "vignetting", "lens_haze"), strict=True):
        make(kind, 7, 4, tmp_path / kind, 1, 4.0, fault)
    homes = [tmp_path / kind / "case_004" for kind in PICTURED]
    names = [sorted(p.name for p in (home / "flight_00" / "mav0").iterdir()) for home in homes]
    assert names[0] == names[1] == names[2]
    assert "cam0" in names[0]
    yaml = [(home / "flight_00" / "mav0" / "cam0" / "sensor.yaml").read_bytes() for home in homes]
    assert yaml[0] == yaml[1] == yaml[2]
    rows = [(home / "flight_00" / "mav0" / "cam0" / "data.csv").read_text().splitlines() for home in homes]
    assert len(rows[0]) == len(rows[1]) == len(rows[2]) > 12
    stamp, name = rows[0][1].split(",")
    assert name == f"{stamp}.jpg"
    assert (homes[0] / "flight_00" / "mav0" / "cam0" / "data" / name).is_file()


def test_no_two_faults_have_one_name() -> None:
    assert len(BY_NAME) == sum(map(len, (FAULTS, FURTHER, STRANGE, STRANGER, SEEN, SEEN_STRANGE)))
