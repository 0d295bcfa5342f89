"""An estimate made by hand: a figure eight whose chain drifts and whose loops are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backend.measurements import LinkCheck, Rejection, RelativePose
from backend.pose_graph.solution import RangeErrors
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.flight import Flight
from slam.core.messages import joined, recorded, warning
from slam.core.streams import Sonar

REJECTION = Rejection(LinkCheck.OTHER, "12 matches, 30 are needed")


def made_estimate(count: int = 60, name: str = "made eight", sigma_m: float = 0.006) -> Estimate:
    """``count`` keyframes on a lying eight of 4.5 m, 0.8 m up; the chain's scale drifts by 15 %."""
    turn = np.linspace(0, 2 * np.pi, count)
    w_T_b = np.tile(np.eye(4), (count, 1, 1))
    w_T_b[:, 0, 3] = 2.25 + 2.25 * np.sin(2 * turn)
    w_T_b[:, 1, 3] = 2.25 * (1 + np.cos(turn))
    w_T_b[:, 2, 3] = 0.8 + 0.02 * np.sin(5 * turn)
    chain = w_T_b.copy()
    chain[:, :3, 3] += np.linspace(0, 0.15, count)[:, None] * (w_T_b[:, :3, 3] - w_T_b[0, :3, 3])
    odometry = 0.3 * chain + 0.7 * w_T_b
    growth = 1 + np.minimum(np.arange(count), np.arange(count)[::-1]) / count
    covariances = (
        np.diag([1e-5] * 3 + [sigma_m**2, (sigma_m / 2) ** 2, sigma_m**2])[None] * growth[:, None, None]
    )
    loops = ((0, count - 1, False), (count // 4, 3 * count // 4, False), (5, count - 9, True))
    edges = [_edge(w_T_b, k, k + 1, "odometry") for k in range(count - 1)]
    edges += [_edge(w_T_b, i, j, "loop") for i, j, is_false in loops if not is_false]
    return Estimate(
        name=name,
        epoch_ns=1_000_000_000,
        stamps_s=np.arange(count) * 0.25,
        frame_names=tuple(f"{k:06d}.png" for k in range(count)),
        frame_index=np.arange(count) * 4,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=0.5 * covariances,
        component=np.zeros(count, dtype=np.int64),
        camera=None,
        floor_z_m=0.0,
        origin=None,
        relative_poses=tuple(edges),
        scale_std=0.05,
        range_errors=RangeErrors(gain=1.0, gain_std=0.05, zero_m=0.0035, zero_std_m=0.0011),
        loops=tuple(LoopVerdict(i, j, REJECTION if is_false else None) for i, j, is_false in loops),
        chain_w_T_b=chain,
        odometry_w_T_b=odometry,
        frames=4 * count,
        rejected={"picture cannot be read": 2, "loop: too few matches": 1},
        timing_s={"track": 1.25, "solve": 0.5},
        messages=(warning("2 pictures could not be read and were left out"),),
        graph_error=12.5,
        iterations=7,
    )


def made_flight(with_sonar: bool = True) -> Flight:
    """A flight that goes with the estimate, without pictures."""
    stamps = np.arange(4) * 1.0
    return Flight(
        name="made eight",
        sonar=Sonar(stamps, np.full(4, 0.8)) if with_sonar else None,
        landmarks={"A": np.array([0.0, 2.1, 0]), "B": np.zeros(3)} if with_sonar else {},
    )


def _edge(w_T_b: np.ndarray, i: int, j: int, kind: str) -> RelativePose:
    return RelativePose(i, j, np.linalg.inv(w_T_b[i]) @ w_T_b[j], np.eye(6) * 1e-4, kind)


def saying(estimate: Estimate, *warnings: str, reasons: tuple[str, ...] = ()) -> Estimate:
    """Return an estimate with these warnings, about what their first words name, and reasons."""
    named = (recorded(text, ()).as_reason() for text in reasons)
    return replace(estimate, messages=joined(*named, *(recorded(text, ()) for text in warnings)))
