"""Joins several flights over the same ground into one, so that one map is made of all.

The pictures follow each other flight by flight. Retrieval then finds loops between flights as it finds loops
within one. Only the streams that a map uses are kept: no inertial stream reaches from a landing to the next
take-off, so segments without features are not bridged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from backend import se3
from frontend.camera import Camera
from slam.core.arguments import flight_tuple
from slam.core.control_points import SurveyedPoint
from slam.core.duplicate_flights import without_duplicates
from slam.core.errors import InputError
from slam.core.fix_check import NOISE_SIGMAS
from slam.core.flight import Flight, with_unique_names
from slam.core.height_systems import height_system_text
from slam.core.messages import Message, warning
from slam.core.names import listed
from slam.core.picture_content import content_key
from slam.core.streams import STREAMS, AttitudeSeries, Frames, Gps, Image, Sonar, Truth

Array = NDArray[np.float64]
_Series = TypeVar("_Series", Sonar, AttitudeSeries, Gps, Truth)

JOINED_STREAMS = ("frames", "sonar", "attitude", "gps", "truth")
"""Fields of ``Flight`` that a map of several flights uses."""

_SAME_MOUNT = 1e-3
"""Mounts differ by less than this, in radians or metres, where they are the same up to rounding."""
PAUSE_S = 20.0
"""Least pause between two flights. It is longer than the 10 s after which a second visit counts as a loop."""


def join_flights(flights: Iterable[Flight]) -> Flight:
    """Join flights on the clock of the first; pictures are named ``A/000001.png``. A single one is returned.

    ``flights`` may be any iterable. A flight that begins before the previous one ends is shifted behind it by
    whole seconds, with a warning. Truth is kept where all flights have it; it must be in the same world.
    The noise and the systematic errors of an instrument are the largest of all flights; GPS positions keep
    their own. Raises ``InputError`` where there is no flight, one has no pictures, cameras or mounts differ,
    or one recording is given twice.
    """
    flights = flight_tuple(flights)
    if not flights:
        raise InputError("no flight to join; give one or more")
    if len(flights) == 1:
        return flights[0]
    for flight in flights:
        _check_same_camera(flights[0], flight)
    _check_same_mounts(flights)
    parts = with_unique_names(flights)
    _, copies = without_duplicates(parts)
    if copies:
        raise InputError(f"{copies[0]}; give it once")
    shifts_s, warnings = _shifts(parts)
    warnings += _levels_differ(parts)
    with_truth = [flight.name for flight in parts if flight.truth is not None]
    if 0 < len(with_truth) < len(parts):
        warnings.append(
            warning(
                f"truth of {', '.join(with_truth)} left out: the other flights have none",
                "evaluate it alone",
            )
        )
    shifted = [_shifted(flight, shift_s) for flight, shift_s in zip(parts, shifts_s, strict=True)]
    truths = [flight.truth for flight in shifted if flight.truth is not None]
    return Flight(
        name=" + ".join(flight.name for flight in parts),
        epoch_ns=parts[0].epoch_ns,
        camera=parts[0].camera,
        frames=_frames(shifted),
        sonar=_joined([_within_limits(flight.sonar) for flight in shifted if flight.sonar is not None]),
        attitude=_joined([flight.attitude for flight in shifted if flight.attitude is not None]),
        gps=_joined([flight.gps for flight in shifted if flight.gps is not None]),
        truth=_joined(truths) if len(truths) == len(parts) else None,
        landmarks={name: place for flight in reversed(parts) for name, place in flight.landmarks.items()},
        landmark_pairs=tuple(dict.fromkeys(pair for flight in parts for pair in flight.landmark_pairs)),
        surveyed=_surveyed(parts),
        gaps=tuple(dict.fromkeys(gap for flight in parts for gap in flight.gaps)),
        messages=(
            *(message.after(flight.name) for flight in parts for message in flight.messages),
            *warnings,
        ),
        all_keyframes=parts[0].all_keyframes,
        parts=parts,
    )


def _levels_differ(flights: Sequence[Flight]) -> list[Message]:
    """Return a line where flights state different levels of their altitudes."""
    of: dict[str, list[str]] = {}
    for flight in flights:
        if flight.gps is not None and flight.gps.height_system and np.isfinite(flight.gps.altitude_m).any():
            of.setdefault(flight.gps.height_system, []).append(flight.name)
    if len(of) < 2:
        return []
    each = "; ".join(f"{height_system_text(system)}: {listed(names)}" for system, names in of.items())
    return [
        warning(
            f"altitudes of the flights count from different levels ({each}), which lie up to a hundred "
            "metres apart: heights of the map are wrong by that",
            "convert the altitudes to one level",
        )
    ]


def _check_same_camera(first: Flight, other: Flight) -> None:
    a, b = first.camera, other.camera
    if a is None or b is None or other.frames is None or len(other.frames) == 0:
        raise InputError(f"{other.name}: no camera in this flight, so it adds no map; leave it out")
    if first.all_keyframes != other.all_keyframes:
        raise InputError(f"{other.name}: photographs and a recording cannot be joined; map each alone")
    if (difference := _difference(a, b)) is not None:
        raise InputError(
            f"{other.name}: another camera than that of {first.name} ({difference}); map each alone"
        )


def _check_same_mounts(flights: Sequence[Flight]) -> None:
    """Check that each instrument is in one place on the body, as far as its flights know it.

    An assumed place is no contradiction. Places of an antenna may differ by their stated uncertainty.
    """
    for name in JOINED_STREAMS:
        series = [(flight.name, getattr(flight, name)) for flight in flights]
        mounted = [(flight_name, s) for flight_name, s in series if hasattr(s, "b_T_s")]
        stated = [(flight_name, s) for flight_name, s in mounted if "T_BS" not in s.assumed]
        for flight_name, s in stated[1:]:
            if difference := _mount_difference(stated[0][1], s):
                raise InputError(
                    f"{flight_name}: {STREAMS[name].folder} mounted in another way than that of "
                    f"{stated[0][0]} ({difference}); map each alone, or correct T_BS"
                )


def _mount_difference(a: Any, b: Any) -> str:
    """Return by how much the mounts of two series differ; empty where it is less than is known of them."""
    std_m = float(np.linalg.norm([s.antenna_std_m for s in (a, b) if isinstance(s, Gps)]))
    apart_m = b.b_T_s[:3, 3] - a.b_T_s[:3, 3]
    if (np.abs(apart_m) > _SAME_MOUNT + NOISE_SIGMAS * std_m).any():
        known = f", known to {std_m:.2g} m" if std_m else ""
        return f"{np.linalg.norm(apart_m):.3g} m apart{known}"
    turn_deg = np.degrees(np.linalg.norm(se3.log(se3.inverse(a.b_T_s[None]) @ b.b_T_s[None])[0, :3]))
    return f"turned by {turn_deg:.3g} deg" if turn_deg > np.degrees(_SAME_MOUNT) else ""


def _difference(a: Camera, b: Camera) -> str | None:
    if a.size_px != b.size_px:
        return f"{b.size_px[0]}x{b.size_px[1]} px, not {a.size_px[0]}x{a.size_px[1]}"
    inner_a, inner_b = (np.array([*c.focal_px, *c.center_px]) for c in (a, b))
    if not np.allclose(inner_a, inner_b, rtol=1e-3):
        return f"intrinsics {inner_b.round(2).tolist()}, not {inner_a.round(2).tolist()}"
    if a.lens != b.lens:
        return f"{b.lens} lens, not {a.lens}"
    widest = max(len(a.distortion), len(b.distortion))
    distortion_a, distortion_b = (np.pad(c.distortion, (0, widest - len(c.distortion))) for c in (a, b))
    if not np.allclose(distortion_a, distortion_b, atol=1e-3):
        return f"distortion {list(b.distortion)}, not {list(a.distortion)}"
    return None if np.allclose(a.b_T_c, b.b_T_c, atol=_SAME_MOUNT) else "mounted in another way"


def _shifts(parts: Sequence[Flight]) -> tuple[list[float], list[Message]]:
    """Return the seconds to add to each flight's stamps, and a warning for each flight that is shifted."""
    shifts, warnings = [0.0], []
    end_s = _span_s(parts[0])[1]
    for flight in parts[1:]:
        begin_s, last_s = _span_s(flight)
        shift = (flight.epoch_ns - parts[0].epoch_ns) / 1e9
        late = float(np.ceil(end_s + PAUSE_S - begin_s - shift))
        if late > 0:
            warnings.append(
                warning(
                    f"{flight.name}: by its clock it begins before the previous flight ends",
                    f"its stamps were shifted by {late:g} s",
                )
            )
            shift += late
        shifts.append(shift)
        end_s = last_s + shift
    return shifts, warnings


def _span_s(flight: Flight) -> tuple[float, float]:
    """Return the first and last stamp of the joined streams, on the flight's own clock."""
    series = [getattr(flight, name) for name in JOINED_STREAMS]
    stamps = [s.stamps_s for s in series if s is not None and len(s.stamps_s)]
    return min(float(s[0]) for s in stamps), max(float(s[-1]) for s in stamps)


def _shifted(flight: Flight, shift_s: float) -> Flight:
    return flight.restamped(JOINED_STREAMS, lambda stamps_s: stamps_s + shift_s)


class JoinedPictures:
    """Loader of the pictures of several flights, one flight after the other."""

    def __init__(self, pictures: Sequence[Frames]) -> None:
        self._pictures, self.failures = pictures, dict[int, str]()
        self._start = np.cumsum([0, *(len(p) for p in pictures)])

    def __call__(self, k: int) -> Image | None:
        """Return picture k, or None with the reason in ``failures``."""
        frames, local = self._place(k)
        picture = frames.load(local)
        if picture is None and local in frames.failures:
            self.failures[k] = frames.failures[local]
        return picture

    def content_key(self, k: int) -> bytes | None:
        """Return that of the picture in its flight."""
        return content_key(*self._place(k))

    def _place(self, k: int) -> tuple[Frames, int]:
        which = int(np.searchsorted(self._start, k, side="right")) - 1
        return self._pictures[which], k - int(self._start[which])


def _frames(parts: Sequence[Flight]) -> Frames:
    pictures = [flight.frames for flight in parts if flight.frames is not None]
    load = JoinedPictures(pictures)
    velocities = [np.full((len(p), 3), np.nan) if p.w_v_m_s is None else p.w_v_m_s for p in pictures]
    return Frames(
        np.concatenate([p.stamps_s for p in pictures]),
        tuple(f"{flight.name}/{file}" for flight, p in zip(parts, pictures, strict=True) for file in p.names),
        load,
        load.failures,
        np.concatenate(velocities) if any(p.w_v_m_s is not None for p in pictures) else None,
    )


def _surveyed(parts: Sequence[Flight]) -> tuple[SurveyedPoint, ...]:
    """Return the surveyed points of all flights, with the new names of the pictures.

    A point that several flights show has the views of all, if they agree on its place. Without a name in the
    survey a point is its place, and has the name of its first flight too.
    """
    found: dict[str, SurveyedPoint] = {}
    for flight in parts:
        for point in flight.surveyed:
            views = tuple(v._replace(picture=f"{flight.name}/{v.picture}") for v in point.views)
            key = point.name if point.is_named else str(_place(point))
            name = point.name if point.is_named else f"{flight.name}/{point.name}"
            before = found.get(key, replace(point, name=name, views=()))
            same = np.array_equal(_place(before), _place(point), equal_nan=True)
            fault = before.fault or point.fault or ("" if same else "flights give it different coordinates")
            found[key] = replace(before, views=before.views + views, fault=fault)
    return tuple(found.values())


def _place(point: SurveyedPoint) -> tuple[float, float, float]:
    return point.latitude_deg, point.longitude_deg, point.altitude_m


def _joined(parts: Sequence[_Series]) -> _Series | None:
    """Return the readings of all flights as one series, each of its fields by its rule; None without any."""
    if not parts:
        return None
    return replace(parts[0], **{f.name: _RULES[f.name](parts, f.name) for f in fields(parts[0])})


def _within_limits(sonar: Sonar) -> Sonar:
    """Leave out ranges beyond the limits of this sonar; those of the joined ones are wider."""
    inside = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    return replace(sonar, range_m=np.where(inside, sonar.range_m, np.nan))


def _concatenated(parts: Sequence[Any], name: str) -> Array | None:
    values = [getattr(part, name) for part in parts]
    return None if any(value is None for value in values) else np.concatenate(values)


def _largest(parts: Sequence[Any], name: str) -> Any:
    """Return the largest number, or the largest of each element."""
    largest = np.max([getattr(part, name) for part in parts], axis=0)
    return tuple(largest.tolist()) if largest.ndim else float(largest)


def _smallest(parts: Sequence[Any], name: str) -> float:
    return float(min(getattr(part, name) for part in parts))


def _noise(parts: Sequence[Any], name: str) -> Any:
    """Return the largest noise, or the median of that of each position where the flights' differ."""
    stds_m = _each_std(parts)
    return _largest(parts, name) if stds_m is None else tuple(np.median(stds_m, axis=0).tolist())


def _each_std(parts: Sequence[Any], _: str = "") -> Array | None:
    """Return the accuracy of each position where that of one flight is not that of all; else None."""
    if not isinstance(parts[0], Gps):
        return None
    stated = {part.noise_std_m for part in parts}
    if len(stated) == 1 and all(part.stds_m is None for part in parts):
        return None
    return _concatenated(parts, "each_std_m")


def _mount(parts: Sequence[Any], name: str) -> Array:
    """Return the mount, one that a flight states if any does. `_check_same_mounts` has compared them."""
    stated = [part for part in parts if "T_BS" not in part.assumed]
    return np.asarray(getattr((stated or parts)[0], name))


def _assumed(parts: Sequence[Any], name: str) -> tuple[str, ...]:
    """Return what any flight assumes: it is stated for a part of the readings alone."""
    return tuple(dict.fromkeys(key for part in parts for key in getattr(part, name)))


def _common(parts: Sequence[Any], name: str) -> str:
    """Return what all flights state; empty where one states nothing or another thing."""
    stated = {getattr(part, name) for part in parts}
    return str(stated.pop()) if len(stated) == 1 else ""


_RULES: dict[str, Callable[[Sequence[Any], str], Any]] = {
    **dict.fromkeys(("stamps_s", "range_m", "roll_pitch_yaw_rad", "w_T_b", "w_v_m_s"), _concatenated),
    **dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_m"), _concatenated),
    **dict.fromkeys(("noise_std_rad", "scale_std", "datum_std_m", "antenna_std_m"), _largest),
    **dict.fromkeys(("max_range_m", "beam_width_rad"), _largest),
    "min_range_m": _smallest,
    "noise_std_m": _noise,
    "stds_m": _each_std,
    "b_T_s": _mount,
    "assumed": _assumed,
    "height_system": _common,
}
"""Field of a series -> its value for several flights. A field without a rule is an error."""
