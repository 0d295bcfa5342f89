from dataclasses import dataclass, field
from typing import Annotated, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from slam.core.errors import InputError
from slam.core.toml_config import load_config, read_toml


@dataclass(frozen=True)
class Lens:
    focal_px: Annotated[float, Field(gt=0)] = 100.0
    kind: Literal["pinhole", "fisheye"] = "pinhole"


@dataclass(frozen=True)
class Rig:
    name: str
    size_px: tuple[int, int] = (4, 3)
    lens: Lens = field(default_factory=Lens)
    spare: Lens | None = None
    others: tuple[Lens, ...] = ()
    marks: dict[str, tuple[float, float]] = field(default_factory=dict)
    stops: tuple[str | tuple[float, float], ...] = ()
    verbose: bool = False

    def __post_init__(self):
        if self.size_px == (0, 0):
            raise ValueError("size_px must not be empty")


def assert_refused(mapping):
    with pytest.raises(InputError) as caught:
        load_config(Rig, mapping, "rig.toml")
    message = str(caught.value)
    assert message.startswith("rig.toml: ")
    assert "\n" not in message
    return message


def test_a_full_mapping_becomes_the_dataclass():
    mapping = {
        "name": "r",
        "size_px": [640, 480],
        "lens": {"focal_px": 3, "kind": "fisheye"},
        "spare": {"focal_px": 2.5},
        "others": [{}, {"focal_px": 1.0}],
        "marks": {"A": [0, 1.5]},
        "stops": ["A", [1, 2]],
        "verbose": True,
    }
    assert load_config(Rig, mapping, "") == Rig(
        "r", (640, 480), Lens(3.0, "fisheye"), Lens(2.5), (Lens(), Lens(1.0)), {"A": (0.0, 1.5)},
        ("A", (1.0, 2.0)), True,
    )  # fmt: skip


def test_an_absent_key_has_its_default():
    assert load_config(Rig, {"name": "r"}, "") == Rig("r")


@pytest.mark.parametrize(
    ("mapping", "key", "nearest"),
    [
        ({"name": "r", "verbos": True}, "verbos", "verbose"),
        ({"name": "r", "lens": {"focal": 1}}, "lens.focal", "lens.focal_px"),
        ({"name": "r", "spare": {"knd": "pinhole"}}, "spare.knd", "spare.kind"),
        ({"name": "r", "others": [{}, {"focl_px": 1}]}, "others.focl_px", "others.focal_px"),
    ],
)
def test_an_unknown_key_names_the_nearest_known_one(mapping, key, nearest):
    message = assert_refused(mapping)
    assert f"'{key}'" in message
    assert f"'{nearest}'" in message


@pytest.mark.parametrize(
    ("mapping", "place"),
    [
        ({}, "'name' is missing"),
        ({"name": "r", "lens": {"focal_px": 0}}, "lens.focal_px: should be greater than 0, got 0"),
        ({"name": "r", "lens": {"focal_px": float("nan")}}, "lens.focal_px: should be greater than 0"),
        ({"name": "r", "lens": {"focal_px": "3"}}, "lens.focal_px: should be a valid number, got '3'"),
        ({"name": "r", "lens": {"kind": "mirror"}}, "lens.kind: should be 'pinhole' or 'fisheye'"),
        ({"name": "r", "lens": 3}, "lens: should be a table, got 3"),
        ({"name": "r", "size_px": [1, 2.5]}, "size_px[1]: should be a valid integer, got 2.5"),
        ({"name": "r", "size_px": [1]}, "size_px"),
        ({"name": "r", "size_px": [0, 0]}, "size_px must not be empty"),
        ({"name": "r", "verbose": 1}, "verbose: should be a valid boolean, got 1"),
        ({"name": "r", "stops": ["A", 5]}, "stops[1]: should be a valid string or should be a valid array"),
        ({"name": "r", "marks": {"A": [0, "x"]}}, "marks.A[1]: should be a valid number"),
        ({"name": "r", "verbose": 1, "size_px": 2}, "(and 1 more)"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_one_line_with_its_place(mapping, place):
    assert place in assert_refused(mapping)


@settings(max_examples=40, deadline=None)
@given(
    st.dictionaries(
        st.text(max_size=8) | st.sampled_from(["name", "size_px", "lens", "marks"]),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
            lambda one: st.lists(one, max_size=3) | st.dictionaries(st.text(max_size=5), one, max_size=3),
            max_leaves=6,
        ),
    )
)  # fmt: skip
def test_any_mapping_is_accepted_or_refused_in_one_line(mapping):
    try:
        taken, message = load_config(Rig, mapping, "x"), ""
    except InputError as error:
        taken, message = None, str(error)
    assert isinstance(taken, Rig) if not message else len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = 1\nb = = 2\n", "line 2"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"#" * 1_000_001, "larger"),
        (b"a = " + b"[" * 20_000, "nested too deeply"),
        (None, "does not exist"),
    ],
)
def test_a_file_that_is_no_toml_is_refused_in_one_line(tmp_path, content, said):
    path = tmp_path / "x.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert said in str(caught.value)
    assert "x.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_is_no_settings_file(tmp_path):
    with pytest.raises(InputError, match="not a file"):
        read_toml(tmp_path)
