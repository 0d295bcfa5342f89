"""Random damage to a flight folder: a flight or one line, nothing else, and never a hang."""

import warnings

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight import STREAMS, Flight
from slam.core.flight_info import describe
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.made_flight import made_flight

SPLICES = (
    b"\n", b",", b",,", b"\0", b"nan", b"inf", b"-", b"1e400", b"#", b'"', b"\r", b"\xff\xfe", b"_", b"'",
    b"9" * 30, b": ", b"[", b"]", b"{", b"&a ", b"*a", b"!!python/none ", b"- ", b"\t", b"../",
    b"\xe2\x80\xa8", b"\xef\xbb\xbf",
)  # fmt: skip


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """One of the ways in which files break."""
    if not data:
        return b"x"
    a, b = sorted(rng.integers(0, len(data), 2).tolist())
    lines = data.split(b"\n")
    k, j = rng.integers(0, len(lines), 2).tolist()
    kind = rng.integers(10)
    if kind == 0:
        flipped = bytearray(data)
        flipped[a] ^= 1 << int(rng.integers(8))
        return bytes(flipped)
    if kind == 1:
        return data[:a]
    if kind == 2:
        return data[:a] + b"\0" * (len(data) - a)
    if kind == 3:
        splice = SPLICES[int(rng.integers(len(SPLICES)))]
        return data[:a] + splice + data[a:]
    if kind == 4:
        return data[:a] + data[b:]
    if kind == 5:
        lines[k], lines[j] = lines[j], lines[k]
        return b"\n".join(lines)
    if kind == 6:
        return b"\n".join([*lines[:k], lines[j], *lines[k:]])
    if kind == 7:
        return b"\n".join(lines[:k] + lines[k + 1 :])
    if kind == 8:
        fields = lines[k].split(b",")
        fields[int(rng.integers(len(fields)))] = SPLICES[int(rng.integers(len(SPLICES)))]
        lines[k] = b",".join(fields)
        return b"\n".join(lines)
    return bytes(rng.integers(0, 256, int(rng.integers(1, 200)), dtype=np.uint8))


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


def run(folder, seed, count):
    rng = np.random.default_rng(seed)
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix in (".csv", ".yaml"))
    files += sorted(folder.rglob("*.png"))[:1]
    read = refused = 0
    for _ in range(count):
        path = files[int(rng.integers(len(files)))]
        whole = path.read_bytes()
        for _ in range(int(rng.integers(1, 4))):
            path.write_bytes(damage(path.read_bytes(), rng))
        if is_refused(folder):
            refused += 1
        else:
            read += 1
        path.write_bytes(whole)
    return read, refused


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


def test_random_damage(folder):
    read, refused = run(folder, seed=1, count=300)
    assert read > 50
    assert refused > 50


@pytest.mark.slow
def test_much_random_damage(folder):
    read, refused = run(folder, seed=2, count=6000)
    assert read > 1000
    assert refused > 1000


def test_any_part_may_be_missing(folder):
    for path in sorted(folder.rglob("*")):
        aside = folder.parent / "aside"
        path.rename(aside)
        is_refused(folder)
        aside.rename(path)
    assert not is_refused(folder)
