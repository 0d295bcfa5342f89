"""The style of all figures: legible in print and safe for colour-blind readers.

The global state of the plotting library is not changed.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.units import axis_names, unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL import Image

# Okabe and Ito's colours, which colour-blind readers can distinguish (jfly.uni-koeln.de/color, 2008).
BLUE, GREEN, VERMILLION, GREY, ORANGE = "#0072b2", "#009e73", "#d55e00", "#8a8f98", "#e69f00"
PURPLE = "#cc79a7"
PALE_GREY = "#c3c7cd"
UNMEASURED = "#b3b8bf"
"""Colour of unmeasured places in a map: a grey that is neither in viridis and magma nor white."""

_MARGIN_IN = 0.12
"""Margin of a cropped figure: the 0.1 of `savefig`, whose boxes around text are larger than what is drawn."""

_STEADY_TICKS = 5
"""Most intervals between ticks of a panel: labels of the default size fit into 0.9 inches."""


def new_figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """Return an empty figure and its axes in the common style."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=160, layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    grid(axes)
    axes.set_axisbelow(True)
    axes.tick_params(colors="#444c56", labelsize=9)
    return figure, axes


def grid(axes: Axes) -> None:
    """Draw pale grid lines."""
    axes.grid(color="#e4e7eb", linewidth=0.6)


def ground_labels(on_earth: bool, metric: bool = True) -> tuple[str, str]:
    """Return the labels of the two axes of a top view."""
    first, second = axis_names(on_earth)
    return f"{first} [{unit(metric)}]", f"{second} [{unit(metric)}]"


def round_factor(factor: float) -> float:
    """Return the largest of ..., 0.1, 0.2, 0.5, 1, 2, 5, 10, ... that is not above ``factor``."""
    steps = [mantissa * 10.0**power for power in range(-6, 7) for mantissa in (1, 2, 5)]
    return max([step for step in steps if step <= factor], default=steps[0])


def legend_below(axes: Axes, columns: int = 4) -> None:
    """Draw the legend below the whole figure."""
    axes.figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def panel_legend_below(axes: Axes, columns: int) -> None:
    """Draw the legend of one panel below that panel."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=columns, fontsize=9, frameon=False)


def steady_ticks(axes: Axes) -> None:
    """Let the ticks of y not depend on the height of the axes.

    The layout measures the labels at its first height of the axes and then changes that height. Ticks that
    follow it may get wider labels, which push the name of the axis off the figure.
    """
    from matplotlib.ticker import MaxNLocator

    axes.yaxis.set_major_locator(MaxNLocator(_STEADY_TICKS, steps=[1, 2, 5, 10]))


def escape_math(text: str) -> str:
    """Return a name from outside with ``$`` escaped, so that it is not read as a formula."""
    return text.replace("$", r"\$")


def png(figure: Figure, cropped: bool = False) -> bytes:
    """Return the figure as a PNG file, ``cropped`` to its content if asked for."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stream = io.BytesIO()
    canvas = FigureCanvasAgg(figure)
    # The figure is drawn once; `savefig` lays it out by drawing it once more, and again to crop it.
    if cropped:
        canvas.draw()  # type: ignore[no-untyped-call]
        rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        _cropped(rgba, _MARGIN_IN * figure.dpi).save(stream, "PNG")
    else:
        canvas.print_png(stream)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def _cropped(rgba: NDArray[np.uint8], margin_px: float) -> Image.Image:
    """Return what differs from the colour of the corner, with a margin."""
    from PIL import Image

    drawn, margin = (rgba != rgba[0, 0]).any(axis=2), round(margin_px)
    filled = [np.flatnonzero(drawn.any(axis=axis)) for axis in (1, 0)]
    content = rgba[tuple(slice(some[0], some[-1] + 1) for some in filled)]
    rows, cols = content.shape[:2]
    framed = np.tile(rgba[0, 0], (rows + 2 * margin, cols + 2 * margin, 1))
    framed[margin : margin + rows, margin : margin + cols] = content
    return Image.fromarray(framed)
