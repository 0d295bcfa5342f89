"""Warning about a height sensor whose stated gain or zero a flight refutes."""

from __future__ import annotations

from backend.bundle.range_evidence import RangePrior
from backend.pose_graph.solution import RangeErrors
from slam.core.messages import Message, about
from slam.core.names import enumerated
from slam.core.units import SPACE, percent, with_error


def refuted_ranges_warning(stated: RangePrior, found: RangeErrors, scale_std: float | None) -> Message:
    """Return the warning about a gain or zero that a map has ``found`` in the place of the ``stated`` one.

    ``scale_std`` is the relative deviation of the lengths of the map.
    """
    wrong: dict[str, str] = {}
    if found.gain_prior_std is not None and found.gain_prior_std > stated.gain_std:
        known = f"± {percent(stated.gain_std)}" if stated.gain_std else "exact"
        wrong["scale_std"] = f"its gain is {with_error(found.gain, found.gain_std)} (stated as {known})"
    if found.zero_prior_std_m is not None and found.zero_prior_std_m > stated.zero_std_m:
        known = f"± {1e3 * stated.zero_std_m:.2g}{SPACE}mm" if stated.zero_std_m else "exact"
        zero = with_error(1e3 * found.zero_m, 1e3 * found.zero_std_m, "+")
        wrong["datum_std"] = f"its zero is {zero}{SPACE}mm (stated as {known})"
    lengths = "" if scale_std is None else f", and its lengths are known to {percent(scale_std)}"
    return about(
        "sonar0",
        f"this flight contradicts what is stated of the height sensor: {enumerated(list(wrong.values()))}",
        "it does not tell which of both is wrong" if len(wrong) > 1 else "",
        f"this map has what was estimated instead{lengths}",
        "hold the drone at two heights measured by tape, correct the readings in sonar0/data.csv or T_BS, "
        f"and state how sure they are as {enumerated(list(wrong))} in sonar0/sensor.yaml",
    )
