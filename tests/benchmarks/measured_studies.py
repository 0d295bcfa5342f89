"""Measured flights of docs/measured, and the references that they are checked with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tests.benchmarks.measured_unseen import Round


@dataclass(frozen=True)
class Study:
    """One page of docs/measured."""

    title: str
    about: str
    """Description of the flights and their source."""
    flights: tuple[str, ...]
    """Flights that are judged together."""
    shown: str
    """The same flights as on a command line."""
    rounds: tuple[Round, ...] = ()
    """Flights that models of other flights predict; a segment of the first round is drawn."""
    drawn: str = ""
    """Replay channel of this segment."""
    truth: Literal["", "motion capture", "gps"] = ""
    """Independent instrument that checks the causes."""


_STEPS = ("forward-1", "forward-3", "left-2", "left-3", "yaw-1", "yaw-2")
_FULL, _HALF = (6, 9, 10), (7, 8, 11, 12)
_ON_TIME = (*_FULL, *_HALF)


def _runs(*numbers: int) -> tuple[str, ...]:
    return tuple(f"ardrone-pulses/run-{k:02d}" for k in numbers)


def _fold(*out: int) -> Round:
    groups = {
        "full stick": _runs(*(k for k in out if k in _FULL)),
        "half stick": _runs(*(k for k in out if k in _HALF)),
    }
    return Round(_runs(*(k for k in _ON_TIME if k not in out)), groups)


def _steps(*names: str) -> tuple[str, ...]:
    return tuple(f"ardrone2-steps/{name}" for name in names)


STUDIES = {
    "ardrone-pulses": Study(
        "AR.Drone: pulses of the forward stick",
        "An AR.Drone, the first model, flown with pulses of full and half forward stick; pitch and forward "
        "speed are those that the drone reports (rc500/ardrone_archive_aarons_laptop, Apache-2.0). Full "
        "stick commands the nominal model's greatest tilt here, as the limit in use was not recorded.",
        _runs(*range(1, 14)),
        "ardrone-pulses/run-*",
        (_fold(6, 7), _fold(9, 8, 11), _fold(10, 12)),
        "velocity.v_x",
    ),
    "ardrone2-steps": Study(
        "AR.Drone 2: steps of one stick at a time",
        "An AR.Drone 2 in a motion-capture room, one stick moved in steps, the on-board attitude at three "
        "readings a second (neroUFV/strats_dataDrivenModel_m, AGPL-3.0). Six runs are judged, by commands "
        "and on-board attitude alone. The others, and the whole motion capture, serve as a check.",
        _steps(*_STEPS),
        " ".join(_steps(*_STEPS)),
        (
            Round(
                _steps(*_STEPS),
                {
                    "forward-2": _steps("forward-2"),
                    "left-1, left-4": _steps("left-1", "left-4"),
                    "yaw-3": _steps("yaw-3"),
                    "up-1 to up-4": _steps("up-1", "up-2", "up-3", "up-4"),
                },
            ),
        ),
        "truth.v_y",
    ),
    "ardrone2-optitrack": Study(
        "AR.Drone 2: position hold in a side wind",
        "An AR.Drone 2 in position hold, with a wind from the side in the second half "
        "(tud-cor/ardrone2_dem_filter, Apache-2.0). Its commands were not recorded, so its motion is not "
        "judged; its instruments are compared with each other.",
        ("ardrone2-optitrack",),
        "ardrone2-optitrack",
        truth="motion capture",
    ),
    "px4flow-quad": Study(
        "A quadrotor with a PX4FLOW, outdoors",
        "Circuits at up to 4 m/s, then hovering, with an optical-flow sensor and a range finder "
        "(priseborough/InertialNav, BSD 3-clause). No commands were recorded, so the instruments are "
        "compared with each other.",
        ("px4flow-quad",),
        "px4flow-quad",
        truth="gps",
    ),
}
