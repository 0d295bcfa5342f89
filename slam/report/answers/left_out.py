"""Data that a map was made without, in plain words, and whether a pilot has to do anything about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from backend.measurements import CONTRADICTED, UNPROVEN, LinkCheck, Rejection
from backend.wording import counted
from slam.core.units import length

_UNITS = {"heights": " of the camera's height", "sigma": " standard deviations", "deg": "°"}
"""Unit of a quantity in a reason -> in words; before metres are known, lengths are in mean heights of the
camera over the floor."""
_LOOP = "loop: "
_NO = "No: "
"""Beginning of an advice to do nothing."""
_ONLY_IF = "Only if "
"""Beginning of an advice to do something in a case that the pilot knows."""
NOT_NEEDED = "others are more accurate"
"""Reason of readings that a map does without."""
_VIEW, _ECHO = "view of a floor point far off", "echo from an obstacle"
_FIX = "fix contradicts the others"
FLY_AGAIN = "Only if that ground matters: fly it again, with more light, higher, or with marks on it."
SLOWER = "Only if the map is in parts: fly slower there, or record more pictures a second."
CUT_THERE = (
    "Only if the mosaic is cut or doubled where many of them lie (map.html shows them): fly that place again "
    "with more overlap."
)
_COPY = "Yes: copy these pictures from the card again; a card that damages more of them is worn out."
_OTHER_PLACE = f"{_NO}ground that looks alike is common, and a false link would bend the map."
_UNPROVEN = f"{_NO}too little in common to tell whether they show one place; the other links hold the map."
_TOO_FEW = "have too few points in common", _UNPROVEN
_WEAK = f"{_NO}the other links hold the map."

_REASONS: tuple[tuple[str, str, str], ...] = (
    ("too few features", "Pictures of bare ground, in the dark or blurred: nothing to recognise", FLY_AGAIN),
    (
        "same picture as the one before",
        "Pictures that the camera sent twice",
        "Only if they are many: the camera froze, and what it passed then is missing.",
    ),
    (
        "late",
        "Pictures that came while earlier ones were worked on",
        "Only if ground is missing: slam optimize uses them all after the flight.",
    ),
    ("tracking started anew", "Times that the view of the ground before was lost", SLOWER),
    (
        _VIEW,
        "Single views of a point of the ground that lies elsewhere in all other pictures: it moved, or "
        "stands above the ground where only two pictures show it",
        f"{_NO}the picture itself stays.",
    ),
    (
        _ECHO,
        "Echoes of the height sensor from what stands on the ground: they are no heights over the ground",
        f"{_NO}elevation.tif shows what stands there.",
    ),
    (
        _FIX,
        "Positions of the GPS that contradict the pictures and the other positions",
        f"{_NO}the others place the map.",
    ),
    (
        "edge without information",
        "Edges of no weight",
        "Only if they should count: correct their information in the file.",
    ),
    (
        "edge disagrees with the rest of the graph",
        "Edges that contradict the rest of the graph",
        "Look at them in map.html: where many lie together, their measurements share an error.",
    ),
    (
        "line ",
        "Lines of the file that are cut short or of another kind",
        "Write the file again if they count.",
    ),
)
"""Beginning of a reason -> what it counts, and whether to act."""
_LINKS: dict[LinkCheck, tuple[str, str]] = {
    LinkCheck.REACH: ("look alike, but were taken too far apart to show the same ground", _OTHER_PLACE),
    LinkCheck.SCALE: ("agree only at scales that differ several times", _OTHER_PLACE),
    LinkCheck.CHAIN: ("lie elsewhere than the pictures between have them", _OTHER_PLACE),
    LinkCheck.PLACE: ("would be linked where the rest of the map cannot have them", _OTHER_PLACE),
    LinkCheck.OVERLAP: ("match in a way that no camera above a floor can see", _OTHER_PLACE),
    LinkCheck.TOO_FEW_MATCHES: _TOO_FEW,
    LinkCheck.TOO_FEW_INLIERS: _TOO_FEW,
    LinkCheck.NO_PLANE: ("have no flat piece of ground in common", _UNPROVEN),
    LinkCheck.OUTLIER_SHARE: ("have points in common of which most disagree", _UNPROVEN),
    LinkCheck.CROWDED: ("have points in common in one small place only", _WEAK),
    LinkCheck.PRECISION: ("fit each other only vaguely", _WEAK),
    LinkCheck.GRAPH: ("contradict the other links", CUT_THERE),
    LinkCheck.KNOWN_PLACE: ("agree, but too little is known of where they lie", _WEAK),
    LinkCheck.SOLVED_PART: ("lie in a part that could not be solved", "See “Check this first” above."),
}
"""The same of pairs of pictures. Other reasons are those of files that cannot be read."""
_UNREADABLE = (
    "unreadable", "picture cannot be read", "missing", "not a file", "truncated", "damaged", "empty",
    "zeroed", "larger than", "is ", "no PNG", "a TIFF",
)  # fmt: skip


@dataclass(frozen=True)
class LeftOut:
    """One row of the table."""

    what: str
    reason: str
    """One of its reasons as summary.json and loops.csv have it."""
    count: int
    act: str

    @property
    def no_need_to_act(self) -> bool:
        """Whether there is nothing to do in any case."""
        return self.act.startswith(_NO)

    @property
    def only_if(self) -> bool:
        """Whether something is to be done only in a case that the pilot knows."""
        return self.act.startswith(_ONLY_IF)

    @property
    def verdict(self) -> str:
        """Verdict of a rejection on a match; empty for other data."""
        return Rejection.read(self.reason.removeprefix(_LOOP)).check.finding if self.kind == "match" else ""

    @property
    def kind(self) -> str:
        """Kind of the data that is counted: "match", "view", "echo", "fix", "reading" or "link"."""
        if self.reason.startswith(_LOOP):
            return "match"
        kinds = {_VIEW: "view", _ECHO: "echo", _FIX: "fix", NOT_NEEDED: "reading"}
        return next((kind for begin, kind in kinds.items() if self.reason.startswith(begin)), "link")


def reason_in_words(rejection: Rejection, height_m: float = float("nan")) -> str:
    """Return why a match was rejected, in plain words, with the figures of the reason in brackets."""
    words, figures = check_in_words(rejection), figures_in_words(rejection, height_m)
    # The figures may have brackets themselves.
    return f"{words} ({figures.replace(' (', ', ').replace(')', '')})" if figures else words


def check_in_words(rejection: Rejection) -> str:
    """Return which check a match failed, in plain words; all words of a reason that no check has."""
    return f"they {_LINKS[rejection.check][0]}" if rejection.check in _LINKS else str(rejection)


def figures_in_words(rejection: Rejection, height_m: float = float("nan")) -> str:
    """Return the figures of a rejection; empty where its check has none.

    Lengths in heights of the camera are told in metres where ``height_m`` is known, the median of the map.
    """
    if rejection.check not in _LINKS:
        return ""

    def as_text(number: str, unit: str) -> str:
        if unit == "heights" and height_m > 0:
            return length(float(number) * height_m)
        return f"{number}{_UNITS.get(unit, f' {unit}')}"

    return rejection.figures_as_text(as_text)


def left_out(rejected: Mapping[str, int], here: Mapping[str, str] = {}) -> tuple[LeftOut, ...]:
    """Return the rows for counts by reason, those that may call for an action first.

    ``here``: advice for a case that the pilot has to tell -> advice for this map, which tells it.
    Reasons that are the same in plain words are one row.
    """
    found = dict[tuple[str, str], LeftOut]()
    for reason, count in rejected.items():
        words = _found(reason)
        earlier = found[words].count if words in found else 0
        found[words] = LeftOut(words[0], reason, earlier + count, here.get(words[1], words[1]))
    rows = found.values()
    order = ("", CONTRADICTED, UNPROVEN)

    def key(row: LeftOut) -> tuple[bool, bool, int, int]:
        return row.no_need_to_act, row.only_if, order.index(row.verdict), -row.count

    return tuple(sorted(rows, key=key))


def counted_by_kind(rows: Sequence[LeftOut], is_graph: bool = False) -> str:
    """Return the numbers of rows by their kind; empty without rows."""
    words = {
        "match": ("match of places", "matches of places"),
        "view": ("single view of a point of the ground", "single views of points of the ground"),
        "echo": ("echo of the height sensor", "echoes of the height sensor"),
        "fix": ("position of the GPS", "positions of the GPS"),
        "reading": ("reading of an instrument", "readings of instruments"),
        "link": ("edge", "edges") if is_graph else ("picture or link", "pictures or links"),
    }
    lines = []
    for kind, name in words.items():
        of_kind = [row for row in rows if row.kind == kind]
        verdicts = [
            f"{sum(row.count for row in of_kind if row.verdict == verdict)} {verdict}"
            for verdict in (CONTRADICTED, UNPROVEN)
            if any(row.verdict == verdict for row in of_kind)
        ]
        if of_kind:
            bracket = f" ({', '.join(verdicts)})" if verdicts else ""
            lines.append(f"{counted(sum(row.count for row in of_kind), *name)}{bracket}")
    return ", ".join(lines)


def _found(reason: str) -> tuple[str, str]:
    of_loops, bare = reason.startswith(_LOOP), reason.removeprefix(_LOOP)
    for beginning, what, act in () if of_loops else _REASONS:
        if bare.startswith(beginning):
            return what, act
    if (check := Rejection.read(bare).check) in _LINKS:
        what, act = _LINKS[check]
        if of_loops:
            return f"Pairs of pictures of two visits that {what}", act
        return f"Pictures that {what} with the one before", SLOWER
    if not of_loops and bare.startswith(_UNREADABLE):
        return f"Pictures whose file cannot be used ({bare})", _COPY
    return f"Left out: {bare}", "Only if ground or links are missing there."
