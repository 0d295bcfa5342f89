"""Which accuracies in a ``sensor.yaml`` are assumed, because the recording does not state them."""

from __future__ import annotations

from slam.io.sensor_yaml import YamlFile

_NOISE = ("noise_std", "gyroscope_noise_density", "accelerometer_noise_density")
_SHARED = {"sonar0": ("scale_std", "datum_std"), "velocity0": ("scale_std",), "gps0": ("T_BS",)}
"""Folder -> keys of the errors that all readings share; the place of a GPS antenna is one."""


def assumed_keys(folder: str, sensor: YamlFile, noise_in_rows: bool) -> tuple[str, ...]:
    """Return the keys of a stream that are not stated, or were assumed by the import that wrote them.

    The noise of an IMU counts as ``noise_std``; ``noise_in_rows``: the rows of the stream state their own.
    Raises ``InputError`` where the assumed keys are no list.
    """
    by_import = sensor.texts("assumed")
    noise_in_file = any(sensor.has(key) for key in _NOISE) and "noise_std" not in by_import
    shared = (key for key in _SHARED.get(folder, ()) if not sensor.has(key) or key in by_import)
    return (*(() if noise_in_rows or noise_in_file else ("noise_std",)), *shared)
