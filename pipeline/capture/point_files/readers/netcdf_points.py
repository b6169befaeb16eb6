"""Reader of NetCDF files of the package movement, and of ``to_xarray().to_netcdf``: HDF5 inside."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.capture.keypoint_files.read_hdf5 import node, opened
from pipeline.capture.point_files.point_reader import MAX_NUMBERS, PointTable, flattened, point_reader
from pipeline.video.frame_rate import measured_rate_hz

_DIMENSIONS = ("time", "individuals", "keypoints", "space")


@point_reader("NetCDF of movement", ".nc")
def read_netcdf(path: Path) -> PointTable:
    """Read ``position`` by the names of its dimensions; metres, if its attribute ``units`` says so."""
    with opened(path) as file:
        parts: dict[str, Any] = {name: node(file, name) for name in (*_DIMENSIONS, "position")}
        if missing := [name for name, part in parts.items() if part is None]:
            raise KeypointsError(f"The file lacks {', '.join(missing)} of movement's poses.")
        position = parts["position"]
        if position.size > MAX_NUMBERS:
            raise KeypointsError(f"The file has more than {MAX_NUMBERS:,} numbers; cut it into several.")
        order = [file[axis[0]].name.strip("/") for axis in position.attrs["DIMENSION_LIST"]]
        xyz = position[...].transpose([order.index(name) for name in _DIMENSIONS])
        if xyz.shape[-1] != 3:
            raise KeypointsError("The poses have two dimensions; 3D points are needed.")
        people, names = (tuple(map(str, parts[name].asstr()[...])) for name in ("individuals", "keypoints"))
        time_s = parts["time"][...].astype(float)
        has_times = "fps" in file.attrs or np.asarray(file.attrs.get("time_unit", "")).astype(str) == "seconds"
        unit = str(position.attrs.get("units", ""))
    rate_hz = measured_rate_hz(time_s) if has_times and len(time_s) > 1 else None
    return PointTable(**flattened(people, names, xyz), rate_hz=rate_hz, unit=unit, start_s=float(time_s[0]))
