"""Settings: a TOML table or mapping becomes a frozen dataclass, or is refused in one line.

The types of the dataclass's fields say what is allowed, and pydantic's ``Field`` in an ``Annotated`` type
gives the range. An unknown key is an error that names the most similar known one.
"""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from pydantic import TypeAdapter, ValidationError

from slam.core.errors import InputError

T = TypeVar("T")

MAX_FILE_BYTES = 1_000_000
"""Limit of a settings file; one that a person writes is far smaller."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file. Raises ``InputError`` where it is missing, too large or not TOML."""
    try:
        if not path.is_file():
            what = "not a file" if path.exists() else "does not exist"
            raise InputError(f"{path}: {what}; give the path of a .toml file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise InputError(f"{path}: larger than {MAX_FILE_BYTES // 1000} kB; this is no settings file")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}; correct that line") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8; give a .toml file") from None
    except ValueError:  # Python's own limit on digits, which tomllib lets through
        raise InputError(f"{path}: holds a number of thousands of digits; write a smaller one") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply; this is no settings file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None


def load_config(cls: type[T], mapping: Mapping[str, Any], where: str) -> T:
    """Return an instance of the dataclass ``cls`` from ``mapping``; absent keys keep their defaults.

    Unknown keys and other types are refused.

    ``where`` names the file in messages. A list fills a tuple and a table a nested dataclass; nothing else
    is converted. Raises ``InputError``, one line: file, key, what is wrong.
    """
    _refuse_unknown_keys(cls, mapping, where, ())
    # In JSON, pydantic's strict mode accepts an array for a tuple.
    text = json.dumps(mapping, default=str)
    try:
        return TypeAdapter(cls).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(f"{where}: {_first_fault(error, mapping)}") from None


def _refuse_unknown_keys(cls: type, mapping: Mapping[str, Any], where: str, path: tuple[str, ...]) -> None:
    types = get_type_hints(cls)
    known = [f.name for f in fields(cls) if f.init]
    for key, value in mapping.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
            hint = f"; did you mean {_dotted((*path, near[0]))!r}?" if near else ""
            raise InputError(f"{where}: unknown key {_dotted((*path, str(key)))!r}{hint}")
        inner = _dataclass_in(types[key])
        tables = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        for table in tables:
            if inner is not None and isinstance(table, Mapping):
                _refuse_unknown_keys(inner, table, where, (*path, key))


def _dataclass_in(annotation: Any) -> type | None:
    """Return the dataclass in a field's type: alone, optional, or in a tuple."""
    if isinstance(annotation, type) and is_dataclass(annotation):
        return annotation
    return next((found for arg in get_args(annotation) if (found := _dataclass_in(arg))), None)


def _first_fault(error: ValidationError, mapping: Mapping[str, Any]) -> str:
    """Return the first fault as ``key: what is wrong, got value``; branches of a union are joined."""
    faults = error.errors(include_url=False, include_context=False)
    places = [_place(fault["loc"], mapping, missing=fault["type"] == "missing") for fault in faults]
    same = [fault for fault, place in zip(faults, places, strict=True) if place == places[0]]
    if same[0]["type"] == "missing":
        return f"key {_dotted(places[0])!r} is missing; add it"
    reasons = dict.fromkeys(f["msg"].removeprefix("Value error, ").removeprefix("Input ") for f in same)
    what = " or ".join(reasons).replace("an object", "a table").replace("a dictionary", "a table")
    name = _dotted(places[0])
    if same[0]["type"] == "value_error":
        return f"{name}: {what}" if name else what
    shown = repr(same[0]["input"])
    others = len(set(places)) - 1
    more = f" (and {others} more)" if others else ""
    return f"{name}: {what}, got {shown if len(shown) <= 60 else shown[:57] + '...'}{more}"


def _place(loc: tuple[int | str, ...], mapping: Any, missing: bool) -> tuple[int | str, ...]:
    """Return the part of ``loc`` that names keys; behind it pydantic names branches of types."""
    place: list[int | str] = []
    for part in loc:
        try:
            mapping = mapping[part]
        except (KeyError, IndexError, TypeError):
            return (*place, part) if missing else tuple(place)
        place.append(part)
    return tuple(place)


def _dotted(place: Sequence[int | str]) -> str:
    """Return ``camera.rate_hz`` or ``way_points[2]``, printable whatever the file holds."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
    return text if text.isprintable() else ascii(text)
