"""An MCAP file of the map with Foxglove's schemas, as Foxglove and Rerun show it.

| topic | schema | what |
|---|---|---|
| /slam/pose | foxglove.PoseInFrame | pose of each keyframe, body in the map |
| /slam/odometry | foxglove.Odometry | the same with its covariance, the name of the picture and the part |
| /slam/path | foxglove.PosesInFrame | all poses, once |
| /slam/links | foxglove.SceneUpdate | links between keyframes, coloured by verdict, once |
| /slam/floor | foxglove.PointCloud | the ground in the colours of the mosaic, once |
| /slam/fix | foxglove.LocationFix | position on Earth of each keyframe, if the map has a place there |
| /slam/log | foxglove.Log | status and warnings, once |
| /camera/image | foxglove.CompressedImage | picture of each keyframe, if the flight is given |
| /camera/calibration | foxglove.CameraCalibration | the camera of each of these pictures |
| /tf | foxglove.FrameTransforms | ``map`` to ``base_link`` at each keyframe |
| /tf_static | foxglove.FrameTransforms | ``base_link`` to ``camera_optical_frame``, if the map has a camera |
"""

from __future__ import annotations

from pathlib import Path

from slam.core.errors import InputError
from slam.io.exports.exported_map import ExportedMap
from slam.io.exports.foxglove.foxglove_file import new_mcap, require_packages


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the file.

    Raises ``InputError`` without the packages of the extra ``foxglove``, for a stamp before 1970, and if the
    flight is not that of the map.
    """
    require_packages()
    from slam.io.exports.foxglove.whole_map import map_facts, write_map

    if exported.flight is not None and exported.estimate.camera is None:
        raise InputError("--photos: the map was made without pictures; leave --photos out")
    with new_mcap(target, map_facts(exported.estimate)) as file:
        return write_map(file, exported)
