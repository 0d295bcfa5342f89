"""Fields of a flight from tables in the columns of the flight format, whatever file they were read from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from slam.core.messages import Message, unread
from slam.core.streams import FIELD_BY_FOLDER, STREAMS
from slam.io.csv_table import CsvTable
from slam.io.gravity_checks import check_gyro_by_gravity, check_quaternion_order
from slam.io.plausibility import check_imu_units
from slam.io.sensor_yaml import YamlFile
from slam.io.series_source import Source
from slam.io.streams import build_series


def build_fields(
    tables: Mapping[str, CsvTable],
    sensors: Mapping[str, YamlFile],
    epoch_ns: int,
    note: Callable[[str, list[Message]], None],
) -> dict[str, Any]:
    """Return the fields of ``Flight`` that hold series, from sorted tables; pictures are left out.

    ``note`` takes the folder of a stream and one line for each loss. Raises ``InputError`` where a value
    contradicts its unit.
    """
    fields: dict[str, Any] = {}
    for name, table in tables.items():
        if name == "cam0":
            continue
        notes: list[Message] = []
        series = build_series(name, Source(table, sensors[name], epoch_ns, notes))
        if series is None and len(table.stamps_ns):
            notes.append(unread("no row is left", "treated as not recorded", "the lines before say why"))
        fields[FIELD_BY_FOLDER[name]] = series
        note(name, notes)
    if fields.get("imu") is not None:
        check_imu_units(fields["imu"], fields.get("attitude"), tables["imu0"].path)
        check_gyro_by_gravity(fields["imu"], tables["imu0"].path)
    if fields.get("imu") is not None and fields.get("truth") is not None:
        path = tables[STREAMS["truth"].folder].path
        check_quaternion_order(fields["truth"], fields["imu"], path)
    return fields
