"""How the filter's kernels are compiled: without the interpreter's lock, sums free to be reordered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from backend.compiled import discard_stale, njit

_ROOT = Path(__file__).parents[3]
discard_stale(
    [
        *(_ROOT / "slam" / "criticism").rglob("*.py"),
        _ROOT / "slam" / "simulation" / "dynamics.py",
        _ROOT / "backend" / "measurements.py",
    ]
)

_FREE = {"contract", "reassoc", "arcp", "nsz"}
"""NaN keeps its meaning: a missing reading is one."""
allocating = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FREE)
kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FREE, _nrt=False)
"""For what makes no arrays but ``on_stack``: nobody counts who holds each array of a bundle at every call."""


@intrinsic(prefer_literal=True)
def on_stack(_typing: Any, size: Any) -> Any:
    """A float array of a constant size, empty, gone when the kernel returns."""
    array = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        length, width = (context.get_constant(types.intp, k) for k in (size.literal_value, 8))
        made = make_array(array)(context, builder)
        room = cgutils.alloca_once(builder, context.get_value_type(types.float64), length)
        populate_array(made, room, [length], [width], width, None)
        return made._getvalue()

    return array(size), generate
