"""Reading of ``sensor.yaml`` and ``flight.yaml``, small YAML files from untrusted sources.

Every scalar stays text until a number is requested, so that YAML does not interpret ``1e-5``, dates or
``1:30``. Size, depth, aliases and tags are checked on the stream of events, before any object is built.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from backend.wording import either
from slam.core.messages import Message, warning
from slam.io.files import brief, read_text, refusal

Array = NDArray[np.float64]
Value = str | list["Value"] | dict[str, "Value"]

MAX_BYTES = 1 << 20
MAX_DEPTH = 8
MAX_LEVER_M = 10.0
"""Largest distance of a sensor from the body origin, for a small aircraft."""
ROUNDING = float(np.finfo(np.float64).eps)
"""Share of the largest reading that a float64 resolves: a smaller noise cannot be in the data."""
RIGID_TOLERANCE = 1e-3
"""Largest element of R^T R - I that is accepted as rounding error."""


@dataclass(frozen=True)
class YamlFile:
    """Mapping from a YAML file, with the line of each key."""

    path: Path
    fields: dict[str, Value] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    notes: tuple[Message, ...] = ()
    """Damage of the file that was repaired."""

    def has(self, key: str) -> bool:
        """Return whether the key is present and has a value."""
        return self.fields.get(key, "") not in ("", "~", "null")

    def text(self, key: str, default: str) -> str:
        """Return a plain text. Raises ``InputError`` for a list or a mapping."""
        value = self.fields.get(key, default)
        if not isinstance(value, str):
            raise self.refuse(key, "is not plain text", "write one value")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of plain texts, none if it is absent. Raises ``InputError`` for anything else."""
        value = self.fields[key] if self.has(key) else []
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise self.refuse(key, "is not a list of plain texts", "write them in [ ]")
        return tuple(str(each) for each in value)

    def number(self, key: str, default: float | None = None, positive: bool = False) -> float:
        """Return one finite number, >= 0 (> 0 if ``positive``). Raises ``InputError``, also for a missing key
        without a default.
        """
        if not self.has(key):
            if default is None:
                raise refusal(self.path, f"has no {key}", "add it")
            return default
        value = self._finite(key, self.fields[key])
        if value < 0 or (positive and value == 0):
            raise self.refuse(key, f"is {value:g}", "write a positive number")
        return value

    def std(self, key: str, default: float, largest: float) -> float:
        """Return a standard deviation >= 0. Raises ``InputError`` as `check_std` does."""
        value = self.number(key, default)
        self.check_std(key, value, largest)
        return value

    def check_std(self, key: str, value: float, largest: float) -> None:
        """Raise ``InputError`` for a standard deviation below 0, or outside what is possible.

        Above ``largest``, the range of what it describes, it holds no information. Below the rounding of that
        range it claims more than a float64 holds. No covariance can be computed with either.
        """
        if value < 0:
            raise self.refuse(key, f"is {value:g}", "write a positive number")
        if value > largest:
            what = f"is {value:g}, beyond the {largest:.3g} that are possible"
            raise self.refuse(key, what, "write the sensor's own, in the unit of the data")
        if 0 < value < ROUNDING * largest:
            what = f"is {value:g}, less than the {ROUNDING * largest:.2g} to which a reading is rounded"
            raise self.refuse(key, what, "write the sensor's own, in the unit of the data")

    def numbers(self, key: str, count: tuple[int, ...]) -> tuple[float, ...]:
        """Return finite numbers, as many as one of ``count``. Raises ``InputError``, also if missing."""
        wanted = " or ".join(map(str, count))
        if not self.has(key):
            raise refusal(self.path, f"has no {key}", f"add it with {wanted} numbers")
        value = self.fields[key]
        if not isinstance(value, list) or len(value) not in count:
            numbers = either(max(count), "number", "numbers")
            raise self.refuse(key, "is not a list of the right length", f"write {wanted} {numbers} in [ ]")
        return tuple(self._finite(key, v) for v in value)

    def transform(self, key: str = "T_BS") -> Array:
        """Return the (4, 4) rigid transform in EuRoC's form, or the identity if it is absent. Raises
        ``InputError``.
        """
        if not self.has(key):
            return np.eye(4)
        body = self.fields[key]
        if not isinstance(body, dict):
            raise self.refuse(key, "is not a matrix", "write rows: 4, cols: 4 and data: [16 numbers]")
        if (body.get("rows", "4"), body.get("cols", "4")) != ("4", "4"):
            raise self.refuse(key, "is not 4 x 4", "write rows: 4, cols: 4 and data: [16 numbers]")
        data = body.get("data")
        if not isinstance(data, list) or len(data) != 16:
            raise self.refuse(key, "has no 16 numbers", "write rows: 4, cols: 4 and data: [16 numbers]")
        T = np.array([self._finite(key, v) for v in data]).reshape(4, 4)
        R = T[:3, :3]
        largest = float(np.abs(R).max())  # its square may overflow
        error = float(np.abs(R.T @ R - np.eye(3)).max()) if largest < 2 else largest
        if (far := math.hypot(*T[:3, 3])) > MAX_LEVER_M:
            raise self.refuse(key, f"puts the sensor {far:g} m from the body", "write metres (millimetres?)")
        if not np.allclose(T[3], (0, 0, 0, 1), atol=1e-9):
            raise self.refuse(key, "does not end in 0, 0, 0, 1", "write a rigid transform, row by row")
        if error > RIGID_TOLERANCE or np.linalg.det(R) < 0:
            what = "is mirrored" if error <= RIGID_TOLERANCE else f"is not a rotation (off by {error:.2g})"
            raise self.refuse(key, what, "write a rigid transform, row by row")
        if error > 1e-9:
            u, _, vt = np.linalg.svd(R)
            T[:3, :3] = u @ vt
        return T

    def misspelt_keys(self, known: tuple[str, ...]) -> list[Message]:
        """Return one remark for each unknown key that resembles a known one."""
        remarks = []
        for key in self.fields:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.8)
            if key not in known and near:
                remarks.append(
                    warning(
                        f"{self.path.name} has {brief(key, 40)}, which is ignored", f"did you mean {near[0]}?"
                    )
                )
        return remarks

    def refuse(self, key: str, what: str, do: str) -> Exception:
        """Return the error to raise about this key."""
        return refusal(self.path, f"{key} {what}", do, self.lines.get(key))

    def _finite(self, key: str, value: Value) -> float:
        try:
            number = float(value) if isinstance(value, str) and "_" not in value else math.nan
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self.refuse(key, f"holds {brief(value, 40)!r}", "write a number")
        return number


def read_yaml(path: Path, root: Path) -> YamlFile:
    """Read a mapping of text, lists and mappings. Raises ``InputError`` for any other content or for an
    unsafe file.
    """
    text, notes = read_text(path, root, MAX_BYTES)
    if text.startswith("%YAML:"):
        text = "#" + text  # OpenCV and EuRoC write this line, which is not a valid YAML directive
    try:
        _check_events(path, text)
        node = yaml.compose(text, Loader=yaml.CBaseLoader)
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise refusal(path, f"is not YAML ({error.problem})", "repair it", line) from None
    except (yaml.YAMLError, ValueError) as error:
        raise refusal(path, f"is not YAML ({error})", "repair it") from None
    if node is None:
        return YamlFile(path, notes=tuple(notes))
    if not isinstance(node, yaml.MappingNode):
        raise refusal(path, "is not a list of `key: value` lines", "repair it")
    fields = _plain(path, node)
    assert isinstance(fields, dict)
    lines = {str(key.value): _line(key) for key, _ in node.value}
    return YamlFile(path, fields, lines, tuple(notes))


def _check_events(path: Path, text: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.CBaseLoader):
        line = 1 if event.start_mark is None else event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise refusal(path, "uses YAML anchors or aliases", "write the values out", line)
        if tag := getattr(event, "tag", None):
            raise refusal(path, f"uses the YAML tag {tag}", "write plain values", line)
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise refusal(path, f"nests deeper than {MAX_DEPTH} levels", "write plain values", line)


def _plain(path: Path, node: yaml.Node) -> Value:
    if isinstance(node, yaml.ScalarNode):
        return str(node.value)
    if isinstance(node, yaml.SequenceNode):
        return [_plain(path, n) for n in node.value]
    fields: dict[str, Value] = {}
    for key, value in node.value:
        line = _line(key)
        if not isinstance(key, yaml.ScalarNode):
            raise refusal(path, "has a key that is not text", "repair it", line)
        if key.value in fields:
            raise refusal(path, f"has {key.value} twice", "keep one of them", line)
        fields[key.value] = _plain(path, value)
    return fields


def _line(node: yaml.Node) -> int:
    return 1 if node.start_mark is None else node.start_mark.line + 1
