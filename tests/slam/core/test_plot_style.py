"""Figures as files."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from slam.core.plot_style import png


def test_a_cropped_figure_is_its_content_with_a_margin():
    figure = Figure(figsize=(3.0, 2.0), dpi=100)
    figure.add_axes((0.4, 0.5, 0.2, 0.1), facecolor="black").set_axis_off()
    figure.patches.append(figure.axes[0].patch)  # the one thing drawn: 60 x 20 pixels
    whole, cropped = (np.asarray(Image.open(io.BytesIO(png(figure, cropped)))) for cropped in (False, True))
    assert whole.shape[:2] == (200, 300)
    assert cropped.shape[:2] == (20 + 2 * 12, 60 + 2 * 12)
    assert (cropped[12:-12, 12:-12, 0] == 0).all()
    assert (cropped[:, :12] == 255).all()
