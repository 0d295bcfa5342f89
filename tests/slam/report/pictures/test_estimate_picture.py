"""The picture of ``slam estimate``: no line hides another, and what is drawn fills its axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from slam.inertial.navigate import navigate
from slam.report.pictures.estimate import estimate_picture
from tests.slam.inertial.made_navigation import made_flight


def drawn(monkeypatch, navigation) -> Figure:
    kept: list[Figure] = []
    monkeypatch.setattr("slam.report.pictures.estimate.png", lambda figure: kept.append(figure) or b"")
    estimate_picture(navigation.estimate, navigation.track)
    kept[0].canvas.draw()
    return kept[0]


@pytest.fixture(scope="module")
def navigation():
    return navigate(made_flight(1))


def ways(axes):
    lines = {line.get_label(): line for line in axes.lines}
    return [lines[name] for name in ("dead reckoning on board", "filter", "smoothed")]


def test_a_line_on_top_of_others_leaves_them_to_be_seen(monkeypatch, navigation):
    top, *_ = drawn(monkeypatch, navigation).axes
    widths = [line.get_linewidth() for line in ways(top)]
    order = [top.lines.index(line) for line in ways(top)]
    assert order == sorted(order)
    assert widths[0] > 1.5 * widths[1] > 2.2 * widths[2]


@pytest.mark.parametrize("shape", [(1.0, 1.0), (1.0, 0.3), (0.3, 1.0)])
def test_the_way_fills_the_top_view_whatever_its_shape(monkeypatch, navigation, shape):
    w_T_b = navigation.estimate.w_T_b.copy()
    turn = np.linspace(0, 2 * np.pi, len(w_T_b))
    w_T_b[:, 0, 3], w_T_b[:, 1, 3] = shape[0] * np.cos(turn), shape[1] * np.sin(turn)
    estimate = replace(navigation.estimate, w_T_b=w_T_b, chain_w_T_b=w_T_b, odometry_w_T_b=w_T_b)
    top, *_ = drawn(monkeypatch, replace(navigation, estimate=estimate)).axes
    shown = np.diff([top.get_xlim(), top.get_ylim()])[:, 0]
    assert (2 * np.array(shape) / shown > 0.6).all()


def test_a_large_uncertainty_does_not_shrink_the_way(monkeypatch, navigation):
    estimate = replace(navigation.estimate, covariances=navigation.estimate.covariances * 1e6)
    top, *_ = drawn(monkeypatch, replace(navigation, estimate=estimate)).axes
    lengths = np.ptp(navigation.estimate.w_T_b[:, :2, 3], axis=0)
    assert (lengths / np.diff([top.get_xlim(), top.get_ylim()])[:, 0]).max() > 0.6
