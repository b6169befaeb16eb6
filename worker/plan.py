"""What there is to do for a session and a spec: stages, their chunks, and the keys of what these leave.

Pure: equal inputs give equal plans, on every machine. A key is a hash of the stage, the version of its code, its part
of the spec and the stages before it down to the digests of the files. So whoever plans the same work again, after a
crash or for another job, asks for the same keys and finds what is there.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from worker.jobs.model import ChunkPlan, Session, StagePlan
from worker.jobs.spec import JobSpec

DETECT, LENGTHS, POSES, ASSOCIATE, FIT, EXPORT = "detect", "lengths", "poses", "associate", "fit", "export"

# A stage's number goes up with every change of its code that changes what it leaves.
# `tests/worker/test_code_versions.py` fails when the code changed and the number did not.
CODE_VERSIONS: Mapping[str, int] = {DETECT: 1, LENGTHS: 2, POSES: 2, ASSOCIATE: 3, FIT: 4, EXPORT: 4}

DEFAULT_CHUNK_FRAMES = 100


def plan(session: Session, spec: JobSpec, chunk_frames: int = DEFAULT_CHUNK_FRAMES) -> tuple[StagePlan, ...]:
    """Cut a reconstruction into stages and chunks.

    Parameters
    ----------
    session
        Its ``preflight`` says how many output frames there are.
    spec
        What was asked for.
    chunk_frames
        Output frames of one chunk of the map, which is of one camera: the frames between a chunk's start and the
        keyframe before are decoded in vain, so few long chunks are better than many short ones of all cameras. Chunks
        begin at its multiples, so two jobs of a session cut alike. No key of a reduce depends on it.

    Returns
    -------
        The stages in their order: detect (map), associate, fit and export (one chunk each). A session of keypoints has
        nothing to detect. Clustering measures bones (one chunk) and finds people (map) before it associates them.
    """
    inputs = _inputs(session)
    frames = spec.frames or range(session.preflight["timebase"]["num_frames"])
    window = {} if spec.frames is None else {"frames": [frames.start, frames.stop]}
    stages: list[StagePlan] = []
    if not is_of_keypoints(session):
        inputs = [
            _key(DETECT, {"detector": spec.detector, **({"leaves": "fields"} if spec.uses_fields else {})}, inputs)
        ]
        stages.append(StagePlan(DETECT, _map_cameras(session, frames, inputs[0], chunk_frames)))
    if spec.method == "clustering":
        lengths = _key(LENGTHS, window, inputs)
        inputs = [_key(POSES, window, [*inputs, lengths])]
        num_measured = _num_measured(session, len(frames))
        stages.append(StagePlan(LENGTHS, _reduce(lengths, num_measured, {"chunk_frames": chunk_frames})))
        stages.append(StagePlan(POSES, _map_frames(frames, inputs[0], chunk_frames)))
    people = {} if spec.people == "auto" else {"people": spec.people}
    associate = _key(ASSOCIATE, {"method": spec.method, **window, **people}, inputs)
    smoothing = {
        "smoothing": spec.smoothing,
        "feet": spec.feet,
        **({"cutoff_hz": spec.cutoff_hz} if spec.smoothing == "butterworth" else {}),
    }
    fit = _key(FIT, smoothing, [associate])
    formats = {
        "exports": sorted(spec.exports),
        **({"bvh": spec.bvh} if "bvh" in spec.exports else {}),
        **({} if spec.output_rate_hz is None else {"output_rate_hz": spec.output_rate_hz}),
    }
    export = _key(EXPORT, formats, [associate, fit])
    stages.extend(StagePlan(name, _reduce(key)) for name, key in ((ASSOCIATE, associate), (FIT, fit), (EXPORT, export)))
    return tuple(stages)


def is_of_keypoints(session: Session) -> bool:
    """Whether the client sent keypoints instead of videos."""
    return any(file.kind == "keypoints" for file in session.files)


def _ranges(frames: range, chunk_frames: int) -> list[tuple[int, int]]:
    """As ``pipeline.video.timeline.chunk_ranges`` cuts them."""
    starts = range(frames.start - frames.start % chunk_frames, frames.stop, chunk_frames)
    return [(max(start, frames.start), min(start + chunk_frames, frames.stop)) for start in starts]


def _map_frames(frames: range, stage_key: str, chunk_frames: int) -> tuple[ChunkPlan, ...]:
    """Ranges of output frames, the same as those of each camera, counted from the first one that is wanted."""
    return tuple(
        ChunkPlan(
            index=index,
            payload={"start_frame": start - frames.start, "stop_frame": stop - frames.start},
            unit_count=stop - start,
            output_key=_hash([stage_key, start, stop]),
        )
        for index, (start, stop) in enumerate(_ranges(frames, chunk_frames))
    )


def _num_measured(session: Session, num_frames: int) -> int:
    """About as many frames as bones are measured in: five a second."""
    return max(1, min(num_frames, round(5 * num_frames / session.preflight["timebase"]["frame_rate_hz"])))


def _map_cameras(session: Session, frames: range, stage_key: str, chunk_frames: int) -> tuple[ChunkPlan, ...]:
    timebase = session.preflight["timebase"]
    pieces = (
        (camera, start, stop)
        for start, stop in _ranges(frames, chunk_frames)
        for camera in session.preflight["cameras"]
    )
    return tuple(
        ChunkPlan(
            index=index,
            payload={"camera": camera["name"], "start_frame": start, "stop_frame": stop},
            # About as many frames as the camera took meanwhile.
            unit_count=max(1, round((stop - start) / timebase["frame_rate_hz"] * camera["frame_rate_hz"])),
            output_key=_hash([stage_key, camera["name"], start, stop]),
        )
        for index, (camera, start, stop) in enumerate(pieces)
    )


def _reduce(
    stage_key: str, unit_count: int = 1, payload: Mapping[str, Any] = MappingProxyType({})
) -> tuple[ChunkPlan, ...]:
    return (ChunkPlan(index=0, payload=dict(payload), unit_count=unit_count, output_key=stage_key),)


def _inputs(session: Session) -> list[str]:
    """What the files are, how they are timed; names count: files and cameras find each other by name."""
    files = sorted(f"{file.kind}/{file.name}/{file.sha256}" for file in session.files)
    if (units := session.preflight.get("units", "m")) != "m":
        files.append(units)
    if is_of_keypoints(session):
        return [*files, repr(session.preflight["timebase"]["frame_rate_hz"])]
    recordings = sorted(json.dumps(one, sort_keys=True) for one in session.preflight.get("recordings", ()))
    return [*files, *recordings]


def _key(stage: str, choices: Mapping[str, Any], inputs: Sequence[str]) -> str:
    return _hash([stage, CODE_VERSIONS[stage], choices, inputs])


def _hash(value: Sequence[Any]) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
