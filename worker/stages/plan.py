"""What there is to do for a session and a spec: stages, their chunks, and the keys of what these leave.

Pure: equal inputs give equal plans, on every machine. A key is a hash of the stage, the digest of its code, its part of
the spec and the stages before it down to the digests of the files. So whoever plans the same work again, after a
crash or for another job, asks for the same keys and finds what is there.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any, Protocol, Self

from pipeline.capture.preflight_record import Preflight
from worker.jobs.model import ChunkPlan, InputFile, StagePlan
from worker.jobs.spec import JobSpec
from worker.stages.code import ASSOCIATE, DETECT, EXPORT, FIT, LENGTHS, POSES, stage_codes

DEFAULT_CHUNK_FRAMES = 100
# A frame of a reduce takes about a tenth of the time of detecting people in it.
_FRAMES_A_UNIT = 10
MAX_CHUNKS = 20_000
"""Most chunks of a stage. Each is a row of the database, and a job is read from all of its rows."""


class SessionFacts(Protocol):
    """What a plan depends on."""

    @property
    def files(self) -> tuple[InputFile, ...]:
        """Its files."""

    @property
    def preflight(self) -> Preflight:
        """What was found in them."""


def plan(
    session: SessionFacts,
    spec: JobSpec,
    chunk_frames: int = DEFAULT_CHUNK_FRAMES,
    codes: Mapping[str, str] | None = None,
) -> tuple[StagePlan, ...]:
    """Cut a reconstruction into stages and chunks.

    Parameters
    ----------
    session
        Its ``preflight`` says how many output frames there are, and which of them have to be worked on.
    spec
        What was asked for.
    chunk_frames
        Output frames of one chunk of the map, which is of one camera: the frames between a chunk's start and the
        keyframe before are decoded in vain, so few long chunks are better than many short ones of all cameras. Chunks
        begin at its multiples, so two jobs of a session cut alike. No key of a reduce depends on it. It is doubled for
        a session that would have more than ``MAX_CHUNKS``.
    codes
        Digests of the stages' code, as of ``stage_codes``; ``None``: of this process's.

    Returns
    -------
        The stages in their order: detect (map), associate, fit and export (one chunk each). A session of keypoints has
        nothing to detect. Clustering measures bones (one chunk) and finds people (map) before it associates them.
        Stages hold ranges, from which their chunks are derived one at a time.
    """
    codes = codes or stage_codes()
    cut = FrameCut.of(session, spec, _bounded_length(session, chunk_frames))
    window = {} if spec.frames is None else {"frames": [cut.frames.start, cut.frames.stop]}
    stages: list[StagePlan] = []

    def key(stage: str, choices: Mapping[str, Any], inputs: Sequence[str]) -> str:
        return _hash([stage, codes[stage], choices, inputs])

    def add(stage: str, chunks: Iterable[ChunkPlan]) -> None:
        stages.append(StagePlan(stage, chunks, codes[stage]))

    inputs = _inputs(session)
    if not is_of_keypoints(session):
        inputs = [
            key(DETECT, {"detector": spec.detector, **({"leaves": "fields"} if spec.uses_fields else {})}, inputs)
        ]
        add(DETECT, _CameraChunks(inputs[0], cut, _frames_per_output_frame(session)))
    if spec.method == "clustering":
        lengths = key(LENGTHS, window, inputs)
        inputs = [key(POSES, window, [*inputs, lengths])]
        add(LENGTHS, _reduce(lengths, _num_measured(session, cut), {"chunk_frames": cut.chunk_frames}))
        add(POSES, _FrameChunks(inputs[0], cut))
    people = {} if spec.people == "auto" else {"people": spec.people}
    associate = key(ASSOCIATE, {"method": spec.method, **window, **people}, inputs)
    smoothing = {
        "smoothing": spec.smoothing,
        "feet": spec.feet,
        **({"cutoff_hz": spec.cutoff_hz} if spec.smoothing == "butterworth" else {}),
    }
    fit = key(FIT, smoothing, [associate])
    formats = {
        "exports": sorted(spec.exports),
        **({"bvh": spec.bvh} if "bvh" in spec.exports else {}),
        **({} if spec.output_rate_hz is None else {"output_rate_hz": spec.output_rate_hz}),
    }
    num_units = -(-cut.num_frames // _FRAMES_A_UNIT)
    add(ASSOCIATE, _reduce(associate, num_units))
    add(FIT, _reduce(fit, num_units))
    add(EXPORT, _reduce(key(EXPORT, formats, [associate, fit]), num_units))
    return tuple(stages)


def is_of_keypoints(session: SessionFacts) -> bool:
    """Whether the client sent keypoints instead of videos."""
    return any(file.kind == "keypoints" for file in session.files)


@dataclass(frozen=True, slots=True)
class FrameCut:
    """How the output frames of a job are cut into ranges.

    Parameters
    ----------
    frames
        The output frames that are wanted.
    stretches
        Output frames of the session that have to be worked on, ascending; pauses lie between them.
    chunk_frames
        Ranges begin at the multiples.
    """

    frames: range
    stretches: tuple[range, ...]
    chunk_frames: int

    @classmethod
    def of(cls, session: SessionFacts, spec: JobSpec, chunk_frames: int) -> Self:
        """Cut the frames that a job wants of a session."""
        whole = range(session.preflight.timebase.num_frames)
        return cls(spec.frames or whole, session.preflight.stretches, chunk_frames)

    def __iter__(self) -> Iterator[range]:
        """Ranges in order, one at least; as ``pipeline.video.timeline.chunk_ranges`` cuts them."""
        stop = 0
        for part in self.parts:
            first = max(stop, part.start // self.chunk_frames)
            stop = -(-part.stop // self.chunk_frames)
            for number in range(first, stop):
                start = number * self.chunk_frames
                yield range(max(start, self.frames.start), min(start + self.chunk_frames, self.frames.stop))

    @property
    def num_frames(self) -> int:
        """Frames of all parts."""
        return sum(map(len, self.parts))

    @property
    def parts(self) -> list[range]:
        """Stretches within the wanted frames; the first wanted frame if there are none."""
        inside = (range(max(one.start, self.frames.start), min(one.stop, self.frames.stop)) for one in self.stretches)
        return [part for part in inside if part] or [self.frames[:1]]


@dataclass(frozen=True, slots=True)
class _CameraChunks:
    """Chunks of a map over ranges of output frames and cameras.

    Parameters
    ----------
    rates
        Frames of each camera an output frame, by camera name.
    """

    stage_key: str
    cut: FrameCut
    rates: Mapping[str, float]

    def __iter__(self) -> Iterator[ChunkPlan]:
        pieces = ((camera, frames) for frames in self.cut for camera in self.rates)
        for index, (camera, frames) in enumerate(pieces):
            yield ChunkPlan(
                index=index,
                payload={"camera": camera, "start_frame": frames.start, "stop_frame": frames.stop},
                # About as many frames as the camera took meanwhile.
                unit_count=max(1, round(len(frames) * self.rates[camera])),
                output_key=_hash([self.stage_key, camera, frames.start, frames.stop]),
            )


@dataclass(frozen=True, slots=True)
class _FrameChunks:
    """Chunks of a map over the same ranges of output frames, counted from the first one that is wanted."""

    stage_key: str
    cut: FrameCut

    def __iter__(self) -> Iterator[ChunkPlan]:
        first = self.cut.frames.start
        for index, frames in enumerate(self.cut):
            yield ChunkPlan(
                index=index,
                payload={"start_frame": frames.start - first, "stop_frame": frames.stop - first},
                unit_count=len(frames),
                output_key=_hash([self.stage_key, frames.start, frames.stop]),
            )


def _bounded_length(session: SessionFacts, chunk_frames: int) -> int:
    """Double the length of chunks until a session has at most ``MAX_CHUNKS``; alike for all of its jobs."""
    most = max(1, MAX_CHUNKS // len(session.preflight.cameras))
    while sum(1 for _ in islice(FrameCut.of(session, JobSpec(), chunk_frames), most + 1)) > most:
        chunk_frames *= 2
    return chunk_frames


def _frames_per_output_frame(session: SessionFacts) -> dict[str, float]:
    session_hz = session.preflight.timebase.frame_rate_hz
    return {camera.name: camera.frame_rate_hz / session_hz for camera in session.preflight.cameras}


def _num_measured(session: SessionFacts, cut: FrameCut) -> int:
    """About as many frames as bones are measured in: five a second."""
    return max(1, min(cut.num_frames, round(5 * cut.num_frames / session.preflight.timebase.frame_rate_hz)))


def _reduce(
    stage_key: str, unit_count: int, payload: Mapping[str, Any] = MappingProxyType({})
) -> tuple[ChunkPlan, ...]:
    return (ChunkPlan(index=0, payload=dict(payload), unit_count=unit_count, output_key=stage_key),)


def _inputs(session: SessionFacts) -> list[str]:
    """What the files are, how they are timed; names count: files and cameras find each other by name."""
    files = sorted(f"{file.kind}/{file.name}/{file.sha256}" for file in session.files)
    if (units := session.preflight.units) != "m":
        files.append(units)
    if is_of_keypoints(session):
        return [*files, repr(session.preflight.timebase.frame_rate_hz)]
    recordings = sorted(json.dumps(asdict(one), sort_keys=True) for one in session.preflight.recordings)
    return [*files, *recordings]


def _hash(value: Sequence[Any]) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
