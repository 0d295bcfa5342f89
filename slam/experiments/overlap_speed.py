"""Largest speed at which consecutive pictures overlap by half (section 3.1).

The speeds follow from the camera. Whether half a picture is enough is tested on pairs of simulated pictures.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from frontend.features import Extractor
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import register
from slam.evaluation.paper_values import FLOOR_AT_1M_M, OVERLAP_SPEED_M_S, TOP_SPEED_M_S, TOP_SPEED_PERCENT
from slam.experiments.experiment import (
    PAPER,
    Conclusion,
    Experiment,
    Row,
    SeedStatistics,
    Trial,
    column,
    over_seeds,
    verdict,
)
from slam.simulation import load_recipe
from slam.simulation.camera.optics import CameraModel, expose
from slam.simulation.camera.photometry import digitise
from slam.simulation.place.scene import build_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

HEIGHT_M, OVERLAP = 1.0, 0.5
OVERLAPS = (0.15, 0.25, 0.35, 0.5, 0.65, 0.8)
WAYS = {"sideways": np.array([0.0, 1.0]), "forwards": np.array([1.0, 0.0])}
"""Direction of flight in the heading frame; a picture is wide across it and low along it."""
RIGHT_PX = 2.0
"""A registration is accepted if its corner error is below this."""
_ROUNDED, _ENOUGH_PERCENT = 0.01, 95.0
PAIRS = 3
"""Number of positions for each overlap and direction."""


def floor_m(size_px: int, model: CameraModel = CameraModel()) -> float:
    """Length of floor seen from ``HEIGHT_M`` along a side of the picture."""
    return float(HEIGHT_M * size_px / model.camera().focal_px[0])


def speed_m_s(rate_hz: float, floor: float) -> float:
    """Speed at which pictures ``1 / rate_hz`` apart overlap by half of ``floor``."""
    return (1 - OVERLAP) * floor * rate_hz


def _trial(seed: int, draw: bool) -> Trial:
    rng = np.random.default_rng((seed, 1))
    model = CameraModel()
    sides = dict(zip(WAYS, (floor_m(side) for side in model.size_px), strict=True))
    figures: dict[str, float] = {}
    for way, direction in WAYS.items():
        for overlap in OVERLAPS:
            step_m = (1 - overlap) * sides[way] * direction
            off = np.array([_error_px(step_m, model, rng) for _ in range(PAIRS)])
            figures[f"{way}/{overlap:g}"] = float(100 * np.mean(off < RIGHT_PX))
            known = off[np.isfinite(off)]
            figures[f"{way} px/{overlap:g}"] = float(np.median(known)) if len(known) else float("nan")
    return Trial(seed, figures)


def _error_px(step_m: Array, model: CameraModel, rng: np.random.Generator) -> float:
    """Largest corner error of the registration of two pictures ``step_m`` (ahead, left) apart, at a random
    position; infinite where the registration fails."""
    camera, extractor = model.camera(), Extractor()
    scene = build_scene(load_recipe("figure_eight").world, ())
    yaw, here = rng.uniform(-np.pi, np.pi), rng.uniform(1.2, 3.3, 2)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :2, :2] = turn
    poses[:, :3, 3] = [[*here, HEIGHT_M], [*(here + turn @ step_m), HEIGHT_M]]
    pictures = [digitise(expose(scene, camera, pose), model.noise_std, rng) for pose in poses]
    a, b = (extractor(picture, camera) for picture in pictures)
    found = register(0, 1, a, b, camera, HomographyConfig(), GateConfig())
    if not found.ok:
        return np.inf
    floor_H = [camera.floor_H_image(pose) for pose in poses]
    true = transfer(np.linalg.inv(floor_H[0]) @ floor_H[1], camera.corners_px)
    return float(np.linalg.norm(transfer(found.i_H_j, camera.corners_px) - true, axis=1).max())


def _share(trials: tuple[Trial, ...], way: str, overlap: float) -> float:
    return float(np.mean(column(trials, f"{way}/{overlap:g}")))


def _exact(value: float) -> dict[str, SeedStatistics]:
    return {"from the camera": SeedStatistics(value, value, value, 1)}


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    width, height = (floor_m(side) for side in CameraModel().size_px)
    speeds = {rate: speed_m_s(rate, width) for rate in OVERLAP_SPEED_M_S}
    follow = abs(width / FLOOR_AT_1M_M - 1) < _ROUNDED and all(
        abs(speeds[rate] / theirs - 1) < _ROUNDED for rate, theirs in OVERLAP_SPEED_M_S.items()
    )
    registered = {way: _share(trials, way, OVERLAP) for way in WAYS}
    slow = min(OVERLAP_SPEED_M_S)
    forwards = speed_m_s(slow, height)
    reason = (
        f"64 degrees across show {width:.3f} m from 1 m (the paper truncates it to {FLOOR_AT_1M_M} m). "
        f"Pictures then overlap by half up to {speeds[15.0]:.2f} m/s at 15 Hz and {speeds[slow]:.2f} m/s at "
        f"{slow} Hz. Of simulated pairs with this overlap, {registered['sideways']:.0f} % register sideways "
        f"and {registered['forwards']:.0f} % forwards. Forwards, a picture is only {height:.2f} m long. "
        f"The limit at {slow} Hz is then {forwards:.2f} m/s, {100 * forwards / TOP_SPEED_M_S:.0f} % of "
        f"the top speed and not {TOP_SPEED_PERCENT:.0f} %."
    )
    enough = min(registered.values()) >= _ENOUGH_PERCENT
    return Conclusion(_rows(trials, width, height), verdict(follow and enough, partly=follow), reason)


def _rows(trials: tuple[Trial, ...], width: float, height: float) -> tuple[Row, ...]:
    """Rows of the camera's figures, then of the registered pairs."""
    paper: dict[str, dict[float, float]] = {"sideways": OVERLAP_SPEED_M_S, "forwards": {}}
    rows = [
        Row("floor seen from 1 m, across", "m", {PAPER: FLOOR_AT_1M_M}, _exact(width)),
        Row("floor seen from 1 m, along", "m", {}, _exact(height)),
    ]
    for way, floor in (("sideways", width), ("forwards", height)):
        for rate in OVERLAP_SPEED_M_S:
            theirs = {PAPER: paper[way][rate]} if rate in paper[way] else {}
            name = f"speed at {rate:g} pictures a second, {way}"
            rows.append(Row(name, "m/s", theirs, _exact(speed_m_s(rate, floor))))
    for way in WAYS:
        for overlap in OVERLAPS:
            name, ours = f"pairs registered at {100 * overlap:.0f} % overlap, {way}", f"{way}/{overlap:g}"
            rows.append(Row(name, "%", {}, {"simulated": over_seeds(trials, ours)}))
        name, ours = f"corner error at {100 * OVERLAP:.0f} % overlap, {way}", f"{way} px/{OVERLAP:g}"
        rows.append(Row(name, "px", {}, {"simulated": over_seeds(trials, ours)}))
    return tuple(rows)


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    left, right = figure.subplots(1, 2)
    rates = np.linspace(2, 15, 2)
    width, height = (floor_m(side) for side in CameraModel().size_px)
    left.plot(rates, speed_m_s(1, width) * rates, color="tab:blue", label="sideways")
    left.plot(rates, speed_m_s(1, height) * rates, color="tab:blue", ls="--", label="forwards")
    left.plot(*zip(*OVERLAP_SPEED_M_S.items(), strict=True), "o", color="tab:red", label="paper")
    left.axhline(TOP_SPEED_M_S, color="0.6", lw=1, label="top speed of the AR.Drone")
    left.set_xlabel("pictures a second")
    left.set_ylabel("largest speed at half overlap, 1 m high [m/s]")
    left.legend(frameon=False, fontsize=8)
    for way, style in (("sideways", "o-"), ("forwards", "s--")):
        shares = [_share(trials, way, overlap) for overlap in OVERLAPS]
        right.plot([100 * overlap for overlap in OVERLAPS], shares, style, color="tab:blue", label=way)
    right.axvline(100 * OVERLAP, color="tab:red", lw=1, label="paper: half")
    right.set_xlabel("overlap of two simulated pictures [%]")
    right.set_ylabel(f"registered to {RIGHT_PX:g} px [%]")
    right.set_ylim(-3, 103)
    right.legend(frameon=False, fontsize=8)


EXPERIMENT = Experiment(
    name="overlap_speed",
    title="Speed at which pictures still overlap by half",
    source="section 3.1",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(10.5, 4.4),
)
