"""Takes as named arrays of xarray, in the dimensions of the package ``movement``, and as data frames of pandas.

Dimensions and attributes: https://movement.neuroinformatics.dev/user_guide/movement_dataset.html
"""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.data.people import Source
from pipeline.core.data.reconstruction import Content, Form, Reconstruction
from pipeline.core.errors import PipelineError
from pipeline.core.paths import StrPath
from pipeline.motion.angles.compute import joint_angles, observable_angles
from pipeline.motion.body_segments import ANGLE_NAMES

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_FEET = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("foot", "heel", "toe"))
# Dimension of the parts of each content, the word for a part, and variables
_CONTENTS: Mapping[str, tuple[str, str, tuple[str, ...]]] = {
    "joints": ("keypoints", "joint", ("confidence", "source", "error_px", "views", "uncertainty_m")),
    "angles": ("angles", "angle", ("angle_deg", "angle_sigma_deg")),
    "contacts": ("feet", "foot", ("contact", "pinned")),
}


def optional_module(name: str) -> Any:
    """Import a package of the extra ``notebook``. Raises ``PipelineError`` if it is not installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        package = (error.name or name).partition(".")[0]
        message = f"The package {package} is not installed. Install it by Multicap's extra: "
        raise PipelineError(f"{message}pip install multicap[notebook].") from error


def individuals(take: Reconstruction) -> list[str]:
    """Names of the people: the person's own name, with the number if several have it."""
    names = [motion.name for motion in take.motions]
    numbers = [track.track_id for track in take.tracks]
    return [name if names.count(name) == 1 else f"{name} {number}" for name, number in zip(names, numbers, strict=True)]


def to_xarray(take: Reconstruction) -> "xr.Dataset":
    """See ``Reconstruction.to_xarray``."""
    xarray = optional_module("xarray")
    num_frames, joints, tracks = take.timebase.num_frames, take.joints, take.tracks
    angle_names = observable_angles(joints)
    shown = [ANGLE_NAMES.index(name) for name in angle_names]

    def empty(parts: tuple[str, ...], fill: float | int | str, *size: int) -> np.ndarray:
        return np.full((num_frames, *size, len(parts), len(tracks)), fill)

    position, confidence = empty(joints.names, np.nan, 3), empty(joints.names, np.nan)
    uncertainty_m, error_px = empty(joints.names, np.nan), empty(joints.names, np.nan)
    views, source = empty(joints.names, 0).astype(np.int16), empty(joints.names, 0).astype(np.int8)
    angle_deg, sigma_deg = empty(angle_names, np.nan), empty(angle_names, np.nan)
    contact, pinned = empty(_FEET, 0.0), empty(_FEET, 0).astype(np.int8)
    for person, (track, motion) in enumerate(zip(tracks, take.motions, strict=True)):
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        position[rows, ..., person] = track.xyz_m.swapaxes(1, 2)
        confidence[rows, :, person], error_px[rows, :, person] = track.score, track.error_px
        views[rows, :, person], source[rows, :, person] = track.views, track.source
        if track.uncertainty_m is not None:
            uncertainty_m[rows, :, person] = track.uncertainty_m
        angles = joint_angles(motion, track, joints)
        of_angles = slice(angles.frames.start, angles.frames.stop)
        angle_deg[of_angles, :, person] = angles.angle_deg[:, shown]
        sigma_deg[of_angles, :, person] = angles.sigma_deg[:, shown]
        for stand in motion.contacts:
            place = motion.start_frame + stand.start_frame, _FEET.index(f"{stand.side}_{stand.part}")
            of_stand = slice(place[0], place[0] + stand.num_frames)
            contact[of_stand, place[1], person] = stand.confidence
            pinned[of_stand, place[1], person] = stand.pinned
    of_joints, of_angles_, of_feet = (("time", *part, "individuals") for part in (["keypoints"], ["angles"], ["feet"]))
    return xarray.Dataset(
        {
            "position": (("time", "space", "keypoints", "individuals"), position, {"units": "m"}),
            "confidence": (of_joints, confidence),
            "uncertainty_m": (of_joints, uncertainty_m),
            "error_px": (of_joints, error_px),
            "views": (of_joints, views),
            "source": (of_joints, source, {"flag_meanings": " ".join(kind.name.lower() for kind in Source)}),
            "angle_deg": (of_angles_, angle_deg),
            "angle_sigma_deg": (of_angles_, sigma_deg),
            "contact": (of_feet, contact),
            "pinned": (of_feet, pinned),
        },
        {
            "frame": ("time", np.arange(num_frames)),
            "time": take.timebase.start_time_s + np.arange(num_frames) / take.timebase.frame_rate_hz,
            "space": list("xyz"),
            "keypoints": list(joints.names),
            "individuals": individuals(take),
            "angles": list(angle_names),
            "feet": list(_FEET),
            "person": ("individuals", np.array([track.track_id for track in tracks], int)),
        },
        {
            "source_software": "Multicap",
            "ds_type": "poses",
            "fps": take.timebase.frame_rate_hz,
            "time_unit": "seconds",
        },
    )


def to_dataframe(take: Reconstruction, of: Content, form: Form) -> "pd.DataFrame":
    """See ``Reconstruction.to_dataframe``."""
    optional_module("pandas")
    dataset = to_xarray(take)
    dimension, part, variables = _CONTENTS[of]
    chosen = dataset[list(variables)]
    if of == "joints":
        chosen = dataset["position"].to_dataset("space").rename(x="x_m", y="y_m", z="z_m").merge(chosen)
    frame = chosen.to_dataframe(["individuals", "time", dimension]).reset_index()
    frame = frame.rename(columns={"individuals": "name", "time": "time_s", dimension: part})
    first = ["person", "name", "frame", "time_s", part]
    frame = frame[[*first, *(name for name in frame if name not in first)]]
    if form == "long":
        known = {"joints": frame.get("source"), "angles": frame.get("angle_deg"), "contacts": frame.get("contact")}[of]
        return frame[known.notna() & (known != 0 if of != "angles" else True)].reset_index(drop=True)
    wide = frame.drop(columns="person").pivot(index=["frame", "time_s"], columns=["name", part])
    wide.columns = [f"{name}.{part}.{value}" for value, name, part in wide.columns]
    return wide.reset_index()


def to_parquet(take: Reconstruction, path: StrPath, of: Content, form: Form) -> Path:
    """See ``Reconstruction.to_parquet``."""
    optional_module("pyarrow")
    path = Path(path)
    try:
        to_dataframe(take, of, form).to_parquet(path, index=False)
    except OSError as error:
        raise PipelineError(f"{path.name} can't be written: {error.strerror or error}.") from error
    return path
