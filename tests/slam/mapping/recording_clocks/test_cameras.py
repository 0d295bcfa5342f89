"""Several recordings of one flight with pictures: those of the camera that looks down are taken."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.messages import about
from slam.core.progress import silent
from slam.core.streams import Frames, Imu
from slam.mapping.recording_clocks.cameras import chosen_camera
from slam.mapping.recording_clocks.join import join_recordings
from tests.slam.io.recordings.ros.made_cameras import (
    AHEAD,
    FOCAL_PX,
    NADIR,
    SIZE_PX,
    MadeFlight,
    seen,
    texture,
)

CENTER_PX = ((SIZE_PX[0] - 1) / 2, (SIZE_PX[1] - 1) / 2)


def mount(b_R_c: np.ndarray) -> np.ndarray:
    b_T_c = np.eye(4)
    b_T_c[:3, :3] = b_R_c
    return b_T_c


def blank(name: str, declared: np.ndarray) -> Flight:
    """A recording of grey pictures, which tell nothing."""
    camera = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, b_T_c=mount(declared))
    grey = np.full(SIZE_PX[::-1], 128, np.uint8)
    frames = Frames(np.arange(4.0), tuple(f"{k}.png" for k in range(4)), lambda k: grey)
    return Flight(name, camera=camera, frames=frames, messages=(about("cam0", f"of {name}"),))


def test_a_declared_mount_tells():
    ahead, down = blank("front", AHEAD), blank("below", NADIR)
    for flights in ([ahead, down], [down, ahead]):
        joined = join_recordings(flights, {})
        assert joined.camera is down.camera
        assert "cam0: of below" in joined.warnings
        assert "cam0: of front" not in joined.warnings, "its pictures are not taken"
        (line,) = [line for line in joined.warnings if "of several cameras" in line]
        assert "that of below is taken" in line
        assert "front (looks 90 degrees aside by its mount)" in line


def test_where_nothing_tells_the_first_is_taken_and_it_is_said():
    joined = join_recordings([blank("a", NADIR), blank("b", NADIR)], {})
    (line,) = [line for line in joined.warnings if "of several cameras" in line]
    assert "that of a is taken" in line
    assert "whether it looks down is not known" in line
    assert chosen_camera([blank("a", NADIR)], silent) is None


def filmed(name: str, b_R_c: np.ndarray, lasts_s: float, rate_hz: float, has_gyro: bool) -> Flight:
    """A recording of a flight through a room; its mount is declared as looking down, as videos assume."""
    flight, surfaces = MadeFlight(), [texture(seed) for seed in range(6)]
    at_s = np.arange(0.0, lasts_s, 1 / rate_hz)
    attitude, place = flight.attitude(at_s).as_matrix(), flight.position(at_s)
    camera = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, b_T_c=mount(NADIR))
    names = tuple(f"{k}.png" for k in range(len(at_s)))
    frames = Frames(at_s, names, lambda k: seen(attitude[k] @ b_R_c, place[k], surfaces))
    gyro_s = np.arange(0.0, lasts_s, 0.01)
    imu = Imu(gyro_s, flight.gyro(gyro_s), flight.accel(gyro_s)) if has_gyro else None
    return Flight(name, camera=camera, frames=frames, imu=imu)


@pytest.mark.slow
@pytest.mark.parametrize(("lasts_s", "has_gyro"), [(50.0, False), (16.0, True)])
def test_pictures_tell(lasts_s, has_gyro):
    ahead = filmed("front", AHEAD, lasts_s, 10.0, has_gyro)
    down = filmed("below", NADIR, lasts_s, 10.0, has_gyro)
    for flights, expected in (([ahead, down], 1), ([down, ahead], 0)):
        found = chosen_camera(flights, silent)
        assert found.recording == expected
        assert "below (looks down" in str(found.remark)
        assert "front (looks aside" in str(found.remark)
