"""Reading of a flight folder in the ASL layout, with a check of every rule of the format.

Faults that change the meaning of the data raise a one-line error. Others are repaired, counted and reported
in ``Flight.warnings``. Pictures stay on disk until they are requested.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.messages import Message, recorded, unread, warning
from slam.core.names import listed
from slam.io.camera_folder import PICTURE_VELOCITY, camera_of, frames_of
from slam.io.clock import sort_by_time
from slam.io.csv_stream import read_names, read_numbers
from slam.io.csv_table import CsvTable
from slam.io.files import brief, brief_message, check_inside, refusal
from slam.io.flight_writer import write_flight
from slam.io.gcp_list import with_own_points
from slam.io.landmarks import check_pairs, read_landmarks
from slam.io.plausibility import check_stamp_unit, check_stamps_agree
from slam.io.sensor_yaml import YamlFile, read_yaml
from slam.io.series_fields import build_fields
from slam.io.streams import COLUMNS, KNOWN_KEYS

__all__ = ["read_flight", "write_flight"]

_NOTE_KEYS = ("vehicle", "place", "date", "source", "licence", "notes")
_FLIGHT_KEYS = ("name", "landmark_pairs", "gaps", "all_keyframes", "assumed", "no_action")
_MAX_LISTED = 8
"""Largest number of flights that the error message for a folder of flights names."""


@dataclass
class _Recording:
    """Content of the folder before the rows are sorted."""

    root: Path
    metadata: YamlFile
    camera: str
    """Folder of the camera that is read as ``cam0``."""
    ignored: Collection[str]
    tables: dict[str, CsvTable] = field(default_factory=dict)
    sensors: dict[str, YamlFile] = field(default_factory=dict)
    warnings: list[Message] = field(default_factory=list)

    def note(self, folder: str, notes: Iterable[Message]) -> None:
        self.warnings += [note.named(folder) for note in notes]


def read_flight(path: Path | str, camera: str = "cam0", ignored: Collection[str] = ()) -> Flight:
    """Read the flight in the folder ``path``.

    ``camera`` is the folder whose pictures are read; a flight folder has ``cam0`` alone. No message names the
    folders that are ``ignored``. Control points come
    from ``gcp_list.txt``, if it is there (`slam.io.gcp_list`).
    The clock of the returned ``Flight`` starts at the smallest first stamp of all streams. Raises
    ``InputError``, with file and line, if a rule of the format is broken and the meaning of the data is
    uncertain.
    """
    root = _flight_root(Path(path))
    metadata = (
        read_yaml(root / "flight.yaml", root)
        if _exists(root / "flight.yaml")
        else YamlFile(root / "flight.yaml")
    )
    recording = _Recording(root, metadata, camera, ignored)
    all_keyframes = _flag(metadata, "all_keyframes")
    recording.warnings += [*metadata.notes, *_assumptions(metadata)]
    _read_streams(recording)
    check_stamps_agree(recording.tables)
    truncated = [name for name, table in recording.tables.items() if table.truncated]
    # Photographs may be hours apart, so their gaps are not clock errors.
    recording.tables, remarks = sort_by_time(recording.tables, trust_clock=all_keyframes)
    recording.warnings += remarks
    firsts = [int(t.stamps_ns[0]) for t in recording.tables.values() if len(t.stamps_ns)]
    epoch_ns = min(firsts, default=0)
    parts = _build(recording, epoch_ns)
    _note_truncation(recording, truncated)
    landmarks, notes = read_landmarks(root) if _exists(root / "landmarks.csv") else ({}, [])
    recording.warnings += [note.concerning("landmarks.csv") for note in notes]
    flight = Flight(
        name=brief(metadata.text("name", "") or root.resolve().name, 120),
        epoch_ns=epoch_ns,
        landmarks=landmarks,
        landmark_pairs=check_pairs(metadata, "landmark_pairs", landmarks),
        gaps=check_pairs(metadata, "gaps", landmarks),
        notes=_notes(recording),
        messages=tuple(recording.warnings),
        all_keyframes=all_keyframes,
        **parts,
    )
    return with_own_points(flight, root)


def _flight_root(root: Path) -> Path:
    """Return the folder after a check that it holds a flight. Raises ``InputError``."""
    try:
        if not root.exists():
            raise refusal(root, "does not exist", "name the folder of a flight")
        if not root.is_dir():
            kind = f"a {root.suffix} file" if root.suffix else "a file"
            raise refusal(
                root, f"is {kind}, not a folder", "name a flight folder, or convert it with slam import"
            )
        if (root / "mav0").is_dir():
            return root
        flights = sorted(
            str(p.parent.relative_to(root)) for depth in ("*", "*/*") for p in root.glob(f"{depth}/mav0")
        )
        names = [p.name for p in root.iterdir()]
    except (OSError, ValueError) as error:
        raise refusal(root, f"cannot be read ({error})", "check the name and its permissions") from None
    if flights:
        raise refusal(root, f"holds flights: {listed(flights, _MAX_LISTED)}", "name one of them")
    if root.resolve().name == "mav0":
        raise refusal(root, "is the inner folder of a flight", "name the folder above it")
    if any(n.lower().endswith((".jpg", ".jpeg", ".png")) for n in names):
        raise refusal(root, "holds pictures but no mav0 folder", "convert photographs with slam import")
    what = "is empty" if not names else "has no mav0 folder, so it is not a flight"
    raise refusal(root, what, "name a folder with mav0/<sensor>/data.csv in it")


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def _read_streams(recording: _Recording) -> None:
    mav0 = recording.root / "mav0"
    check_inside(mav0, recording.root)
    try:
        folders = sorted(p for p in mav0.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise refusal(mav0, f"cannot be read ({error.strerror})", "check its permissions") from None
    known = {recording.camera, *COLUMNS}
    if not any(p.name in known for p in folders):
        found = brief(", ".join(p.name for p in folders) or "nothing", 120)
        raise refusal(mav0, f"has no known stream (found: {found})", f"add one of {', '.join(sorted(known))}")
    for folder in folders:
        if folder.name in known:
            _read_stream(recording, folder)
        elif folder.name not in recording.ignored:
            line = warning(
                "not a stream of the flight format, skipped", "docs/flight-format.md lists the streams"
            )
            recording.note(brief(folder.name, 60), [line])


def _read_stream(recording: _Recording, folder: Path) -> None:
    name, root = "cam0" if folder.name == recording.camera else folder.name, recording.root
    if not folder.is_dir():
        raise refusal(folder, "is not a folder", "write it as a folder with sensor.yaml and data.csv")
    for part in ("sensor.yaml", "data.csv"):
        if not _exists(folder / part) and (part == "data.csv" or name == "cam0"):
            raise refusal(folder / part, "does not exist", f"add it, or remove the folder {folder.name}")
    if _exists(folder / "sensor.yaml"):
        sensor = read_yaml(folder / "sensor.yaml", root)
        recording.note(name, (*sensor.notes, *sensor.misspelt_keys(KNOWN_KEYS)))
    else:
        sensor = YamlFile(folder / "sensor.yaml")
        recording.note(
            name, [warning("has no sensor.yaml: nominal figures assumed", "add one with its noise_std")]
        )
    csv = folder / "data.csv"
    if name == "cam0":
        table = read_names(csv, root, "filename", PICTURE_VELOCITY)
    else:
        table = read_numbers(csv, root, COLUMNS[name])
    notes = list(table.notes)
    check_stamp_unit(table, sensor, notes)
    if not len(table.stamps_ns):
        notes.append(
            unread("data.csv has no rows", "treated as not recorded", "check that the sensor was on")
        )
    recording.note(name, notes)
    recording.tables[name], recording.sensors[name] = table, sensor


def _build(recording: _Recording, epoch_ns: int) -> dict[str, Any]:
    """Return the fields of ``Flight`` built from the sorted tables."""
    parts = build_fields(recording.tables, recording.sensors, epoch_ns, recording.note)
    if (table := recording.tables.get("cam0")) is not None:
        notes: list[Message] = []
        camera: Camera = camera_of(recording.sensors["cam0"], notes)
        parts["camera"] = camera
        parts["frames"] = frames_of(table, camera, epoch_ns, recording.root, notes)
        recording.note("cam0", notes)
    return parts


def _note_truncation(recording: _Recording, truncated: list[str]) -> None:
    """Note the seconds that a truncated file lacks, compared with the stream that ends last."""
    ends = {name: int(t.stamps_ns[-1]) for name, t in recording.tables.items() if len(t.stamps_ns)}
    for name in truncated:
        if name in ends and (lost := (max(ends.values()) - ends[name]) * 1e-9) > 0.5:
            recording.note(
                name,
                [
                    warning(
                        f"was cut short: its last {lost:.1f} s are lost",
                        "copy it again if the recorder has them",
                    )
                ],
            )


def _flag(metadata: YamlFile, key: str) -> bool:
    text = metadata.text(key, "false").lower() or "false"
    if text not in ("true", "false", "yes", "no"):
        raise metadata.refuse(key, f"is {text[:40]!r}", "write true or false")
    return text in ("true", "yes")


def _assumptions(metadata: YamlFile) -> list[Message]:
    """Return the notes about losses, repairs and assumptions from an earlier conversion of the flight."""
    notes = _lines(metadata, "no_action")
    return [brief_message(recorded(line, notes)) for line in _lines(metadata, "assumed")]


def _lines(metadata: YamlFile, key: str) -> list[str]:
    lines = metadata.fields.get(key, [])
    if not isinstance(lines, list):
        raise metadata.refuse(key, "is not a list of lines", "write one `- line` for each")
    texts = [line for line in lines if isinstance(line, str)]
    if len(texts) < len(lines):
        raise metadata.refuse(key, "is not a list of lines", "write one `- line` for each")
    return texts


def _notes(recording: _Recording) -> dict[str, str]:
    notes = {}
    for key, value in recording.metadata.fields.items():
        if key in _FLIGHT_KEYS or value == "":
            continue
        if isinstance(value, str):
            notes[key] = value
        else:
            recording.note(
                "flight.yaml", [warning(f"{brief(key, 40)} is not plain text, ignored", "write one line")]
            )
    recording.note("flight.yaml", recording.metadata.misspelt_keys((*_FLIGHT_KEYS, *_NOTE_KEYS)))
    return notes
