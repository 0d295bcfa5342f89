"""Mean distance of features matched in consecutive pictures (section 4.1: 22.1, 32.9 and 32.7 px).

The paper specifies neither the space nor the frame rate. Its unit indicates pixels of the picture: the
distance in the picture between the two features of a match. Each feature is matched with the nearest
descriptor of the previous picture (section 3.1), no match is rejected, and the frame rate is that of the
paper's computer. A right match is as long as the motion of the picture, which brightness cannot change. A
wrong match has any length. The mean is therefore (1 - p) d_right + p d_wrong, and brightness acts only
through the share p of wrong matches. The truth tells which matches are wrong. The mean distance of
descriptors is reported too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from frontend.features import Extractor, Features
from frontend.homography import transfer
from slam.evaluation.association import poses_at
from slam.evaluation.paper_values import FEATURE_DISTANCE_PX
from slam.experiments.experiment import (
    DRONE,
    SIMULATOR,
    Conclusion,
    Experiment,
    Row,
    Trial,
    over_seeds,
    text,
    verdict,
)
from slam.experiments.stitching import PICTURE_S, at_pace
from slam.simulation import load_recipe, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slam.core.flight import Flight
    from slam.simulation import Recipe

Array = NDArray[np.float64]

RIGHT_PX = 3.0
"""A match is wrong if it is farther than this from its true position."""
STRENGTHS = (0.0, 1.0, 2.0)
"""Strengths of the filter: none, as shipped, and twice that."""


@dataclass(frozen=True)
class _Matches:
    """Mean distances over all pairs of consecutive pictures of one flight."""

    distance_px: Array
    descriptor: Array
    wrong: NDArray[np.bool_]


def _recipe(strength: float) -> Recipe:
    recipe = load_recipe("square_white_balance")
    values = recipe.model.terms["exposure_variation"]
    terms = {"exposure_variation": {**values, **{key: strength * values[key] for key in ("gain", "gamma")}}}
    return replace(recipe, model=replace(recipe.model, terms=terms if strength else {}))


def _trial(seed: int, draw: bool) -> Trial:
    figures: dict[str, float] = {}
    histograms = {}
    for strength in STRENGTHS:
        found = _matches(at_pace(simulate(_recipe(strength), seed), PICTURE_S))
        right = ~found.wrong
        figures |= {
            f"px/{strength:g}": float(found.distance_px.mean()),
            f"right px/{strength:g}": float(found.distance_px[right].mean()),
            f"wrong px/{strength:g}": float(found.distance_px[found.wrong].mean()),
            f"wrong/{strength:g}": float(100 * found.wrong.mean()),
            f"descriptor/{strength:g}": float(found.descriptor.mean()),
        }
        if draw:
            edges = np.linspace(0, 160, 41)
            histograms[strength] = np.histogram(found.distance_px, edges, density=True)[0]
    for key in ("px", "right px", "wrong", "descriptor"):
        for strength in STRENGTHS[1:]:
            figures[f"{key} ratio/{strength:g}"] = figures[f"{key}/{strength:g}"] / figures[f"{key}/0"]
    return Trial(seed, figures, histograms)


def _matches(flight: Flight) -> _Matches:
    assert flight.camera is not None
    assert flight.frames is not None
    assert flight.truth is not None
    extractor, camera = Extractor(), flight.camera
    poses = poses_at(flight.truth, flight.frames.stamps_s)
    parts: list[tuple[Array, Array, NDArray[np.bool_]]] = []
    before: Features | None = None
    floor_H_before = np.eye(3)
    for frame in flight.frames:
        picture = frame.read()
        assert picture is not None
        now, floor_H_now = extractor(picture, camera), camera.floor_H_image(poses[frame.index])
        if before is not None and len(before) and len(now):
            # For unit descriptors the nearest has the largest inner product.
            likeness = now.descriptor @ before.descriptor.T
            nearest = likeness.argmax(axis=1)
            cosine = likeness[np.arange(len(now)), nearest].astype(float)
            partner = before.pixel[nearest]
            true = transfer(np.linalg.inv(floor_H_before) @ floor_H_now, now.pixel)
            parts.append(
                (
                    np.linalg.norm(partner - now.pixel, axis=1),
                    np.sqrt(np.maximum(2 - 2 * cosine, 0)),
                    np.linalg.norm(partner - true, axis=1) > RIGHT_PX,
                )
            )
        before, floor_H_before = now, floor_H_now
    distance, descriptor, wrong = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _Matches(distance, descriptor, wrong)


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    paper = FEATURE_DISTANCE_PX["with"] / FEATURE_DISTANCE_PX["without"]
    ratio, twice, right = (
        over_seeds(trials, key) for key in ("px ratio/1", "px ratio/2", "right px ratio/1")
    )
    wrong, wrong_with = over_seeds(trials, "wrong/0"), over_seeds(trials, "wrong/1")
    near, far = over_seeds(trials, "right px/0").median, over_seeds(trials, "wrong px/0").median
    needed = [100 * (FEATURE_DISTANCE_PX[key] - near) / (far - near) for key in ("without", "with")]
    reason = (
        f"the filter multiplies the mean distance of matches in the picture by {text(ratio)}, and at twice "
        f"its strength by {twice.median:.2f}. The paper's factor is {paper:.2f}. Brightness can "
        f"explain wrong matches only. Their share rises from {wrong.median:.0f} to {wrong_with.median:.0f} "
        f"%. The distance of right matches is the motion of the picture (ratio {right.median:.3f}). Our "
        f"distances of right and wrong matches are {near:.1f} and {far:.0f} px. With them, the paper's means "
        f"correspond to {needed[0]:.0f} and {needed[1]:.0f} % of wrong matches. Faster motion between two "
        "pictures would increase the mean too."
    )
    alike = ratio.lower95 <= paper <= ratio.upper95
    return Conclusion(_rows(trials, paper), verdict(alike, partly=ratio.lower95 > 1), reason)


def _rows(trials: tuple[Trial, ...], paper: float) -> tuple[Row, ...]:
    columns = {"no filter": "0", "filter": "1", "filter, twice": "2"}

    def row(name: str, unit: str, key: str) -> Row:
        return Row(name, unit, {}, {label: over_seeds(trials, f"{key}/{s}") for label, s in columns.items()})

    px = FEATURE_DISTANCE_PX
    ratios = {label: over_seeds(trials, f"px ratio/{s}") for label, s in columns.items() if s != "0"}
    return (
        Row(
            "mean distance, filter over none",
            "1",
            {SIMULATOR: paper, DRONE: px["drone"] / px["without"]},
            ratios,
        ),
        Row(
            "mean distance in the picture",
            "px",
            {
                SIMULATOR + ", no filter": px["without"],
                SIMULATOR + ", filter": px["with"],
                DRONE: px["drone"],
            },
            row("", "px", "px").ours,
        ),
        row("of right matches", "px", "right px"),
        row("of wrong matches", "px", "wrong px"),
        row("share of wrong matches", "%", "wrong"),
        row("mean distance of descriptors", "1", "descriptor"),
    )


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    left, right = figure.subplots(1, 2)
    labels = {0.0: "no filter", 1.0: "filter", 2.0: "filter, twice"}
    edges = np.linspace(0, 160, 41)
    for strength, density in trials[0].drawing.items():
        left.stairs(density, edges, label=labels[strength], lw=1.6)
    left.set_yscale("log")
    left.yaxis.set_major_formatter("{x:g}")
    left.set_xlabel("distance of the two features of a match in the picture [px]")
    left.set_ylabel("density [1/px]")
    left.set_title("one flight: all matches", fontsize=10)
    left.legend(frameon=False)
    for k, strength in enumerate(STRENGTHS):
        ours = [trial.figures[f"px/{strength:g}"] for trial in trials]
        right.plot(
            np.full(len(ours), k),
            ours,
            "o",
            ms=4,
            alpha=0.6,
            color="tab:blue",
            label="ours" if not k else None,
        )
    for key, style in (("without", "--"), ("with", "-"), ("drone", ":")):
        name = {"without": "paper, no filter", "with": "paper, filter", "drone": "paper, AR.Drone"}[key]
        right.axhline(FEATURE_DISTANCE_PX[key], color="tab:red", ls=style, lw=1.2, label=name)
    right.set_xticks(range(len(STRENGTHS)), [labels[strength] for strength in STRENGTHS])
    right.set_ylabel("mean distance [px]")
    right.set_ylim(bottom=0)
    right.set_title("each point one flight", fontsize=10)
    right.legend(frameon=False, fontsize=8)


EXPERIMENT = Experiment(
    name="feature_distance",
    title="Mean distance of matched features",
    source="section 4.1",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(11.0, 4.6),
)
