"""The warning that parts of a map rest on lines, which do not show motion along themselves."""

from __future__ import annotations

import numpy as np

from backend.wording import either
from slam.core.messages import Message, warning
from slam.mapping.map import Map


def lines_alone_warning(map_: Map) -> Message | None:
    """Return the warning for keyframes that were aligned by lines; None without any."""
    aligned = {k for r in map_.kept_registrations if r.by_lines for k in (r.i, r.j)}
    placed = [k for k in sorted(aligned) if map_.component[k] == 0]
    if not placed:
        return None
    problem = map_.bundle.optimum.problem if map_.bundle is not None else None
    has_scale = problem is not None and (problem.inertial is not None or problem.reported is not None)
    by = "only the instruments measure" if has_scale else "nothing measures"
    variances = np.trace(map_.covariances[placed][:, 3:, 3:], axis1=1, axis2=2)
    std_m = float(np.sqrt(variances.max())) if np.isfinite(variances).all() else np.inf
    error = f"up to ± {std_m:.2g} m" if np.isfinite(std_m) else "of unknown size"
    return warning(
        f"{len(placed)} of {int((map_.component == 0).sum())} keyframes "
        f"{either(len(placed), 'shows', 'show')} lines but few features, and {by} motion along them where "
        "no other line crosses",
        f"expect an error {error} in what is measured there",
    )
