"""Values as bytes: bit for bit the same when read, and never code."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from slam.core.packing import UnpackError, digest_of, pack, unpack


class Side(Enum):
    LEFT = "left"


@dataclass(frozen=True)
class Held:
    side: Side
    array: np.ndarray
    parts: tuple[object, ...]


VALUES = np.array([[1.0, np.nan, -0.0], [np.inf, 5e-324, 0.1]])
HELD = Held(Side.LEFT, VALUES, (1, 0.1, "ü", None, True, b"\0\xff", [2], {3: "x"}, np.float32(0.1)))


def test_a_value_comes_back_bit_for_bit():
    found = unpack(pack(HELD), (Held, Side))
    assert pack(found) == pack(HELD)
    assert found.array.tobytes() == VALUES.tobytes()
    assert found.parts == HELD.parts
    assert [type(a) for a in found.parts] == [type(b) for b in HELD.parts]


@pytest.mark.parametrize("array", [VALUES, VALUES.T, VALUES[:, :0], np.array(3), np.arange(4, dtype="u1")])
def test_an_array_keeps_its_layout_and_can_be_changed(array):
    found = unpack(pack(array))
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.flags.c_contiguous == array.flags.c_contiguous
    assert found.flags.writeable
    assert np.array_equal(found, array, equal_nan=array.dtype.kind == "f")


@pytest.mark.parametrize("value", [object(), lambda: 0, np.array([object()]), {1, 2}])
def test_what_is_no_data_is_refused(value):
    for made in (pack, digest_of):
        with pytest.raises(TypeError):
            made(value)


def test_other_bytes_are_refused():
    whole = pack(HELD)
    for damaged in (b"", whole[:7], whole[:-1], whole[:40], pickle.dumps(1), b"\0" * 100):
        with pytest.raises(UnpackError):
            unpack(damaged, (Held, Side))


def test_a_class_that_the_reader_does_not_name_is_not_built():
    with pytest.raises(UnpackError):
        unpack(pack(HELD), (Side,))


def test_a_digest_tells_values_apart_that_look_alike():
    alike = [1, 1.0, True, "1", b"1", (1,), [1], ("1", ""), ("", "1"), (1, 2), ((1,), 2), None, 0.0, -0.0]
    alike += [np.float32(1), np.array([1]), np.array([[1]]), np.array([1.0]), VALUES, VALUES.T]
    assert len({digest_of(value) for value in alike}) == len(alike)
    assert digest_of(HELD) == digest_of(unpack(pack(HELD), (Held, Side)))
