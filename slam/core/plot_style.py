"""The kit that every drawing is made with: no global state of the plotting library is touched, legible in
print, colour-blind safe."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from slam.core.units import unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by colour-blind readers (jfly.uni-koeln.de/color, 2008).
BLUE, GREEN, VERMILLION, GREY, ORANGE = "#0072b2", "#009e73", "#d55e00", "#8a8f98", "#e69f00"
PALE_GREY = "#c3c7cd"
UNMEASURED = "#b3b8bf"
"""Of a map, where nothing was measured: a grey that viridis and magma do not have, and no white."""


def new_figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """An empty drawing in the style of all of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=160, layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    grid(axes)
    axes.set_axisbelow(True)
    axes.tick_params(colors="#444c56", labelsize=9)
    return figure, axes


def grid(axes: Axes) -> None:
    """Lines that do not compete with what is drawn over them."""
    axes.grid(color="#e4e7eb", linewidth=0.6)


def ground_labels(on_earth: bool, metric: bool = True) -> tuple[str, str]:
    """What stands at the two axes of a top view."""
    return ("east [m]", "north [m]") if on_earth else (f"x [{unit(metric)}]", f"y [{unit(metric)}]")


def round_factor(factor: float) -> float:
    """The largest of ..., 0.1, 0.2, 0.5, 1, 2, 5, 10, ... that is not above ``factor``."""
    steps = [mantissa * 10.0**power for power in range(-6, 7) for mantissa in (1, 2, 5)]
    return max([step for step in steps if step <= factor], default=steps[0])


def legend_below(axes: Axes, columns: int = 4) -> None:
    """The legend, under the whole drawing."""
    axes.figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def panel_legend_below(axes: Axes, columns: int) -> None:
    """The legend of one panel among several, under it."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=columns, fontsize=9, frameon=False)


def escape_math(text: str) -> str:
    """A name from outside, not read as a formula."""
    return text.replace("$", r"\$")


def png(figure: Figure, cropped: bool = False) -> bytes:
    """The drawing as a file, ``cropped`` to what is drawn on it."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", bbox_inches="tight" if cropped else None)
    return stream.getvalue()
