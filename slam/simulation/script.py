"""Scripts: lists of timed commands, flown open loop as in the paper (section 4.2).

A script is a text file with one command a line, ``milliseconds,forward,left,up,yaw``. A command is held until
the next line. The last line gives the end of the flight. Text after a ``#`` is a comment.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError, explain
from slam.simulation.manoeuvre import MAX_DURATION_S, Manoeuvre, Row
from slam.simulation.stick import Stick

Array = NDArray[np.float64]

MAX_BYTES = 10_000_000
COLUMNS = "milliseconds,forward,left,up,yaw"


def read_script(path: Path) -> tuple[Row, ...]:
    """Return the commands of a script file. Raises ``InputError`` with the file and the line."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such script; give a text file of {COLUMNS}")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: larger than {MAX_BYTES // 1_000_000} MB; this is no script")
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; give one of {COLUMNS}") from None
    except OSError as error:
        raise InputError(f"{path}: {explain(error)}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        text = line.partition("#")[0].strip()
        if text:
            try:
                ms, forward, left, up, yaw = (float(cell) for cell in text.split(","))
            except ValueError:
                raise InputError(f"{path}, line {number}: {text[:40]!r}: write {COLUMNS}") from None
            rows.append((ms, forward, left, up, yaw))
    return tuple(rows)


def stick_from(manoeuvre: Manoeuvre) -> Stick:
    """Return the stick of a manoeuvre with a script. Raises ``InputError`` for invalid commands."""
    rows = read_script(Path(manoeuvre.script)) if isinstance(manoeuvre.script, str) else manoeuvre.script
    if len(rows) < 2:
        raise InputError("maneuver.script: write at least a command and a last line with the flight's end")
    table = np.array(rows, dtype=float)
    stamps_s, values = table[:, 0] / 1000, manoeuvre.scale * table[:, 1:]
    for k in range(len(table)):
        what = f"maneuver.script, command {k + 1} ({', '.join(f'{cell:g}' for cell in rows[k])})"
        if not np.isfinite(table[k]).all() or stamps_s[k] < 0:
            raise InputError(f"{what}: give finite numbers and a time from 0 on")
        if k and stamps_s[k] <= stamps_s[k - 1]:
            raise InputError(f"{what}: its time is not after the one before; sort the commands")
        if np.abs(values[k]).max() > 1:
            raise InputError(f"{what}: the stick goes from -1 to 1; with scale it is {values[k].tolist()}")
    duration_s = stamps_s[-1] + 2 * manoeuvre.rest_s
    if duration_s > MAX_DURATION_S:
        raise InputError(f"maneuver.script: the flight would last {duration_s / 3600:.1f} h; 6 h is the most")
    # The last row releases the stick, for the hover after it.
    values[-1] = 0.0
    return Stick(stamps_s + manoeuvre.rest_s, values, duration_s)
