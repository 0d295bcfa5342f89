"""Parts of a flight folder that are missing: a flight or one line, nothing else."""

import warnings

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.streams import STREAMS
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.made_flight import made_flight


def check(flight: Flight) -> None:
    """What every stage behind the reader relies on."""
    series = [getattr(flight, f) for f in STREAMS]
    for one in [s for s in series if s is not None]:
        assert len(one.stamps_s) > 0
        assert np.isfinite(one.stamps_s).all()
        assert (np.diff(one.stamps_s) > 0).all()
    if flight.imu is not None:
        assert np.isfinite(flight.imu.gyro_rad_s).all()
        assert np.isfinite(flight.imu.accel_m_s2).all()
    if flight.truth is not None:
        R = flight.truth.w_T_b[:, :3, :3]
        np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.eye(3)[None].repeat(len(R), 0), atol=1e-9)
    assert all("\n" not in line for line in flight.warnings)
    if flight.frames is not None:
        flight.frames[0].read()
    describe(flight)


def is_refused(folder) -> bool:
    """Read and check; anything but a sound flight or one line with a remedy raises here."""
    message = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check(read_flight(folder))
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert not message or "; " in message
    return bool(message)


@pytest.fixture
def folder(tmp_path):
    write_flight(made_flight(seconds=3.0), tmp_path / "f")
    return tmp_path / "f"


def test_any_part_may_be_missing(folder):
    for path in sorted(folder.rglob("*")):
        aside = folder.parent / "aside"
        path.rename(aside)
        is_refused(folder)
        aside.rename(path)
    assert not is_refused(folder)
