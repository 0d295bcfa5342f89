"""Planar bundle adjustment on the measurements themselves: see `backend.bundle.refinement`."""
