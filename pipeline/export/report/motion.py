"""Motion of a take in its report: fewer fields than viewers get, thinned out if the take is long."""

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.recfunctions import repack_fields

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.quality.views import PersonViews
from pipeline.export.viewer.description import ViewerMotion
from pipeline.motion.body.shape import BodyShapes

MAX_MOTION_BYTES = 4 * 2**20
"""Largest size of the motion in 3D; of a longer take each n-th frame is kept."""

# Fields of the records that are drawn.
_FIELDS = ["origin_m", "joints", "skeleton"]


def embed_motion(
    take: Reconstruction,
    views: Sequence[PersonViews],
    metrics: Mapping[str, Any],
    shapes: BodyShapes | None = None,
    max_bytes: int = MAX_MOTION_BYTES,
) -> dict[str, Any]:
    """Describe a take as ``motion.json`` does, with its frames inside.

    ``metrics`` is the content of ``metrics.json``; people have human bodies if there are ``shapes``. ``stride`` is the
    number of output frames from one kept frame to the next; ``frames`` has the records of these of each person, in
    base64.
    """
    motion = ViewerMotion(take, views, {}, metrics, shapes=shapes)
    dtype = repack_fields(motion.dtype[_FIELDS], align=True)
    stride = choose_stride([track.num_frames for track in take.tracks], dtype.itemsize, max_bytes)
    frames = [track.start_frame + np.arange(track.num_frames) for track in take.tracks]
    is_kept = np.concatenate([np.zeros(0, int), *frames]) % stride == 0
    kept, done = [], 0
    for block in motion.encode():
        records = np.frombuffer(block, motion.dtype)
        drawn = records[is_kept[done : done + len(records)]]
        thin = np.zeros(len(drawn), dtype)
        for name in _FIELDS:
            thin[name] = drawn[name]
        kept.append(thin.tobytes())
        done += len(records)
    document: dict[str, Any] = json.loads(motion.describe())
    document["record"]["num_bytes"] = dtype.itemsize
    places: dict[str, Any] = dict(dtype.fields or {})
    document["record"]["offsets"] = {name: places[name][1] for name in _FIELDS}
    return {**document, "stride": stride, "frames": base64.b64encode(b"".join(kept)).decode("ascii")}


def choose_stride(num_frames: Sequence[int], record_bytes: int, max_bytes: int) -> int:
    """Choose the smallest stride with which records are at most as large as wanted, or one for each person.

    ``num_frames`` are the people's numbers of frames.

    >>> choose_stride([300, 300], 100, 20_000)
    3
    """
    stride = 1
    while any(num > stride for num in num_frames) and sum(-(-num // stride) for num in num_frames) > max(
        1, max_bytes // max(1, record_bytes)
    ):
        stride += max(1, stride // 8)
    return stride
