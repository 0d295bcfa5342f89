"""Test of the accuracy that a GPS receiver states, or that is assumed, on what its fixes differ from the map.

The map's own errors have a pattern that errors of satellite positions lack. An error of the camera model is
constant in the axes of the body, one of the lens bends the map smoothly, and one of the stamps follows the
velocity. The pattern is chosen by the Bayesian information criterion. Source: Schwarz 1978.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit, f_tail
from slam.core.messages import Message, warning
from slam.mapping.gps.altitude_course import AltitudesOnMap, altitude_course
from slam.mapping.gps.consensus import FALSE_ALARM, LEAST_FIXES, STATED_SIGMAS

Array = NDArray[np.float64]

_DOUBTED = {
    "body": (
        "they are constant in the axes of the vehicle ({value}), as a wrong principal point, mount or "
        "antenna position makes them: the camera model is doubted, not the GPS",
        "calibrate the camera, and state the antenna's place in gps0/sensor.yaml",
    ),
    "place": (
        "they vary smoothly over the map ({value}), as lens distortion makes them: the map's shape is "
        "doubted, not the GPS",
        "calibrate the lens",
    ),
    "delay": (
        "they follow the velocity ({value}), as late stamps do: the clocks are doubted, not the GPS",
        "check the stamps of pictures and fixes",
    ),
    "step": (
        "they follow the velocity from {since} on ({value}), as a clock that was set then does: the clocks "
        "are doubted, not the GPS",
        "check the stamps of pictures and fixes",
    ),
    "scale": (
        "they grow with the distance ({value}), as another scale does: lengths of the map and the GPS "
        "contradict each other",
        "check the unit and the gain of the height sensor and the focal length",
    ),
    "mirror": (
        "they are a mirror image of the map ({value}): latitude and longitude, or the letters E and W, or N "
        "and S, are exchanged, or the pictures are mirrored",
        "correct them and map again: scale, heading and place of this map are wrong",
    ),
    "altitude": (
        "altitudes that drift make such differences, and so does a map that is bent or tilted: heights and "
        "slopes of the map are doubted",
        "do not measure these on it, or add control points",
    ),
    "": (
        "they have no pattern that camera, lens or clock would make: the {said} accuracy is doubted",
        "correct noise_std in gps0/sensor.yaml",
    ),
}
"""Kind of a pattern -> what it leaves in doubt, and what to do."""
_MOST_LEFT = 0.25
"""Share of the squares that a pattern leaves at most: half of the standard deviation."""
_MOST_STEPS = 64
"""Fixes at which a step of the clock is tried. A step in the first or last eighth of the fixes can hardly be
told from a delay, or from none."""


@dataclass(frozen=True)
class FixesOnMap:
    """Fixes with the map's pose at the time of each."""

    off_m: Array
    """(n, 2) fix minus map, horizontal."""
    w_p_m: Array
    """(n, 2) position on the map."""
    w_R_b: Array
    """(n, 3, 3) attitude."""
    velocity_m_s: Array
    """(n, 2); zero where the times are unknown."""
    names: tuple[str, ...]
    """(n,) in order of time."""


@dataclass(frozen=True)
class Pattern:
    """Pattern in the differences between fixes and map."""

    kind: str
    """``body``, ``place``, ``mirror``, ``scale``, ``delay``, ``step``, ``altitude``, or empty for none."""
    share: float
    """Share of the squared differences that it explains."""
    value: str
    """The pattern in figures."""
    since: str = ""
    """Name of the fix from which on a step shows."""


@dataclass(frozen=True)
class Contradiction:
    """Fixes that differ from the map by far more than the receiver states, or than is assumed of it."""

    differs: str
    """Sentence with the stated accuracy and the differences."""
    pattern: Pattern
    stated: bool = True

    @property
    def warning(self) -> Message:
        """The sentence, with what the pattern leaves in doubt."""
        value = f"{self.pattern.value}; {100 * self.pattern.share:.0f} % of the squares"
        said = "stated" if self.stated else "assumed"
        why, do = _DOUBTED[self.pattern.kind]
        why = why.format(value=value, said=said, since=self.pattern.since)
        return warning(f"{self.differs}, which is taken as their noise: {why}", do).concerning("gps0")


def mirror_contradiction(fixes: FixesOnMap) -> Contradiction | None:
    """Return how the fixes lie where they fit the mirror image of the map significantly better; else None.

    A similarity of the map fits mirrored fixes by shrinking, and leaves differences within their accuracy
    where the ground is small. Both fits have as many parameters: an F-test needs no accuracy.
    """
    to, of = (points @ (1, 1j) for points in (fixes.w_p_m + fixes.off_m, fixes.w_p_m))
    dof = 2 * len(of) - 4
    if len(of) < LEAST_FIXES:
        return None
    as_is, mirrored = (
        float(np.sum(np.abs(to - J @ np.linalg.lstsq(J, to, rcond=None)[0]) ** 2))
        for J in (np.column_stack([np.ones_like(of), shape]) for shape in (of, of.conj()))
    )
    if mirrored > _MOST_LEFT * as_is or f_tail(as_is / (mirrored + 1e-30), dof, dof) > FALSE_ALARM:
        return None
    off_m, mirrored_m = np.sqrt(as_is / dof), np.sqrt(mirrored / dof)
    differs = f"gps0: its fixes differ from the map by {off_m:.2g} m a horizontal axis"
    figures = f"that image is {mirrored_m:.2g} m off them"
    return Contradiction(differs, Pattern("mirror", 1.0 - mirrored / as_is, figures))


def stated_accuracy_contradiction(
    fixes: FixesOnMap, stated_std_m: tuple[float, float, float], stated: bool = True
) -> Contradiction | None:
    """Return how the fixes differ from the map where it is by far more than they state; else None.

    ``stated``: whether the receiver states these deviations; else they are assumed.
    """
    nominal = float(np.hypot(*stated_std_m[:2]) / np.sqrt(2))
    std = _excess(fixes.off_m, 2 * len(fixes.off_m) - 4, nominal)
    if std is None:
        return None
    differs = (
        f"gps0: {_said(nominal, stated)}, but its fixes differ from the map by {std:.2g} m a horizontal axis "
        f"({std / nominal:.0f} sigmas)"
    )
    return Contradiction(differs, pattern(fixes), stated)


def altitude_contradiction(up_m: Array, nominal: float, stated: bool = True) -> Contradiction | None:
    """Return how altitudes differ from the map, ``up_m`` (n,), if by far more than ``nominal`` (m)."""
    # The map's height and, in part, its slopes along and across follow from the altitudes.
    std = _excess(up_m, len(up_m) - 3, nominal)
    if std is None:
        return None
    differs = (
        f"gps0: {_said(nominal, stated)} for altitudes, but they differ from the map by {std:.2g} m "
        f"({std / nominal:.0f} sigmas)"
    )
    return Contradiction(differs, Pattern("altitude", 0.0, ""), stated)


def altitude_course_contradiction(altitudes: AltitudesOnMap, nominal: float) -> Contradiction | None:
    """Return how altitudes drift or step against the map by more than is assumed of them; else None."""
    course = altitude_course(altitudes, nominal)
    differs = f"gps0: {_said(nominal, False)} for altitudes, but {course}"
    return Contradiction(differs, Pattern("altitude", 0.0, ""), False) if course else None


def _said(nominal: float, stated: bool) -> str:
    return f"states {nominal:.2g} m" if stated else f"{nominal:.2g} m assumed"


def _excess(off_m: Array, dof: int, nominal: float) -> float | None:
    """Return the standard deviation of the differences of some fixes, (n, 2) or (n,), with ``dof`` degrees of
    freedom, where it exceeds the nominal one by far; else None."""
    if len(off_m) < LEAST_FIXES or nominal <= 0:
        return None
    squares = float(np.sum(off_m**2))
    std = float(np.sqrt(squares / dof))
    if std < STATED_SIGMAS * nominal or squares / nominal**2 < chi_square_limit(FALSE_ALARM, dof):
        return None
    return std


def pattern(fixes: FixesOnMap) -> Pattern:
    """Return the pattern that explains the horizontal differences best; none if chance explains them."""
    r = fixes.off_m.reshape(-1)
    best, least = Pattern("", 0.0, ""), len(r) * np.log(np.mean(r**2) + 1e-30)
    for model in _models(fixes):
        J = model.J
        if len(r) <= J.shape[1] + 2 or np.linalg.matrix_rank(J) < J.shape[1]:
            continue
        parameters: Array = np.linalg.lstsq(J, r, rcond=None)[0].astype(float)
        left = float(np.sum((r - J @ parameters) ** 2))
        if left > _MOST_LEFT * float(np.sum(r**2)):
            continue
        # The fix where a step begins is a parameter, too.
        count = J.shape[1] + (model.kind == "step")
        criterion = len(r) * np.log(left / len(r) + 1e-30) + count * np.log(len(r))
        if criterion < least:
            share = 1.0 - left / float(np.sum(r**2))
            since = fixes.names[model.first] if model.kind == "step" else ""
            best, least = Pattern(model.kind, share, _in_figures(model, parameters, fixes), since), criterion
    return best


@dataclass(frozen=True)
class _Model:
    kind: str
    J: Array
    """(2n, k) design matrix of the differences east and north of each fix in turn."""
    first: int = 0
    """First fix that a step shows in."""


def _models(fixes: FixesOnMap) -> Iterator[_Model]:
    """Yield the models. Each has constant and linear terms, as the similarity that places the map takes its
    share of every pattern."""
    n = len(fixes.off_m)
    centred = fixes.w_p_m - fixes.w_p_m.mean(axis=0)
    x, y = (centred / max(_extent(fixes), 1e-9)).T
    terms = np.column_stack([np.ones(n), x, y, x**2, x * y, y**2])
    turned = np.column_stack([-y, x])
    similar = np.column_stack(
        [np.kron(np.ones((n, 1)), np.eye(2)), np.column_stack([x, y]).reshape(-1), turned.reshape(-1)]
    )
    body = fixes.w_R_b[:, :2, :2].reshape(2 * n, 2)
    delay = fixes.velocity_m_s.reshape(2 * n, 1)
    yield _Model("scale", similar)
    yield _Model("body", np.column_stack([body, similar]))
    yield _Model("place", np.kron(terms, np.eye(2)))
    yield _Model("delay", np.column_stack([delay, similar]))
    for first in np.unique(np.linspace(n / 8, 7 * n / 8, _MOST_STEPS).astype(int)).tolist():
        later = np.repeat(np.arange(n) >= first, 2)[:, None]
        yield _Model("step", np.column_stack([delay * later, similar]), first)


def _extent(fixes: FixesOnMap) -> float:
    return float(np.abs(fixes.w_p_m - fixes.w_p_m.mean(axis=0)).max())


def _in_figures(model: _Model, parameters: Array, fixes: FixesOnMap) -> str:
    if model.kind == "body":
        return f"{parameters[0]:+.2g} m forward, {parameters[1]:+.2g} m left"
    if model.kind in ("delay", "step"):
        return f"{-parameters[0]:+.2g} s"
    if model.kind == "scale":
        return f"lengths by the GPS are {1 + parameters[2] / _extent(fixes):.3g} times those of the map"
    bend = (model.J @ parameters).reshape(-1, 2)
    return f"up to {float(np.linalg.norm(bend, axis=1).max()):.2g} m"
