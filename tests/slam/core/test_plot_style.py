"""Figures as files."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from slam.core.plot_style import png, steady_ticks


def test_a_cropped_figure_is_its_content_with_a_margin():
    figure = Figure(figsize=(3.0, 2.0), dpi=100)
    figure.add_axes((0.4, 0.5, 0.2, 0.1), facecolor="black").set_axis_off()
    figure.patches.append(figure.axes[0].patch)  # the one thing drawn: 60 x 20 pixels
    whole, cropped = (np.asarray(Image.open(io.BytesIO(png(figure, cropped)))) for cropped in (False, True))
    assert whole.shape[:2] == (200, 300)
    assert cropped.shape[:2] == (20 + 2 * 12, 60 + 2 * 12)
    assert (cropped[12:-12, 12:-12, 0] == 0).all()
    assert (cropped[:, :12] == 255).all()


def test_the_layout_does_not_push_the_names_of_axes_off_the_figure():
    """At these limits ticks that follow the height of the axes get wider labels after the layout."""
    figure = Figure(figsize=(4, 9), dpi=80, layout="constrained")
    panels = figure.subplots(4, 1, sharex=True)
    for axes in panels:
        axes.set_ylim(-6.1, 6.1)
        axes.set_ylabel("y")
        steady_ticks(axes)
    panels[-1].set_xlabel("x")
    panels[0].set_title("t")
    png(figure, cropped=True)
    assert all(axes.yaxis.label.get_window_extent().x0 > 0 for axes in panels)
