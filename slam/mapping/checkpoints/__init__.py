"""Checkpoints of a map: results of an earlier run, each found by a digest of all that it depends on.

One module for each kind of work (`slam.core.checkpoints.Work`), but for the mosaics:
`slam.report.rasters.checkpoints`.
"""
