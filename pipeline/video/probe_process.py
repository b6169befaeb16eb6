"""Examine several video files, each in a child process with limits; see ``pipeline.video.probe``."""

import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pipeline.core.errors import Problem
from pipeline.core.runtime.confinement import READY, ChildLimits, Fork, child_error, run_child
from pipeline.video.container import reading_s
from pipeline.video.info import Timecode, VideoInfo
from pipeline.video.probe import is_of_file, limits_problem, problem_before_opening

_TIMEOUT_S = 120.0


def probe_in_children(paths: Sequence[Path]) -> list[VideoInfo | Problem]:
    """Examine video files, each in a child process with limits on time and memory.

    A file that makes FFmpeg crash, hang or exhaust memory ends only its own child. All children have ended when the
    function returns or raises, also on an interruption. Returns properties or problem of each file, in the order of
    ``paths``. Raises ``ChildError`` if a child fails for a reason other than its file.
    """
    results: list[VideoInfo | Problem | None] = [problem_before_opening(path) for path in paths]
    numbers = [number for number, problem in enumerate(results) if problem is None]
    if numbers:
        for number, result in zip(numbers, _probe([paths[number] for number in numbers]), strict=True):
            results[number] = result
    return [result for result in results if result is not None]


def _probe(paths: Sequence[Path]) -> list[VideoInfo | Problem]:
    limits_s = [_TIMEOUT_S + 2 * reading_s(path) for path in paths]
    files = [[str(path.absolute()), limit_s] for path, limit_s in zip(paths, limits_s, strict=True)]
    timeout_s = _TIMEOUT_S + sum(limits_s)
    end = run_child("pipeline.video.probe", [], ChildLimits(cpu_s=None), timeout_s, json.dumps(files).encode())
    results: dict[int, VideoInfo | Problem] = {}
    for fork in _forks(end.output):
        path = paths[fork.number]
        if not is_of_file(fork):
            raise child_error(f"check of {path.name}", fork.exit_code, limits_s[fork.number], fork.errors)
        results[fork.number] = _result(path, fork)
    for number, path in enumerate(paths):
        if number not in results:
            raise child_error(f"check of {path.name}", end.exit_code, timeout_s, end.errors)
    return [results[number] for number in range(len(paths))]


def _forks(output: bytes) -> Iterator[Fork]:
    """Ends of processes in what the program wrote; an incomplete one is left out."""
    file = io.BytesIO(output)
    while (line := file.readline()).endswith(b"\n"):
        end = json.loads(line)
        if len(content := file.read(end["size"])) == end["size"]:
            yield Fork(end["number"], end["exit_code"], content, end["errors"])


def _result(path: Path, fork: Fork) -> VideoInfo | Problem:
    if fork.exit_code != 0:
        return limits_problem(path.name)
    answer = json.loads(fork.output.removeprefix(READY))
    if "problem" in answer:
        return Problem(**answer["problem"])
    return VideoInfo(
        path=path,
        codec=answer["codec"],
        size_px=(answer["size_px"][0], answer["size_px"][1]),
        rotation_deg=answer["rotation_deg"],
        is_mirrored=answer["is_mirrored"],
        pts=np.array(answer["pts"], np.int64),
        keyframe_pts=np.array(answer["keyframe_pts"], np.int64),
        time_s=np.array(answer["time_s"], np.float64),
        frame_rate_hz=answer["frame_rate_hz"],
        num_repeated=answer["num_repeated"],
        stored_width_px=answer["stored_width_px"],
        timecode=Timecode(**answer["timecode"]) if answer["timecode"] else None,
        created_s=answer["created_s"],
        warnings=tuple(Problem(**warning) for warning in answer["warnings"]),
        browser_media_type=answer["browser_media_type"],
        media_start_s=answer["media_start_s"],
        tick_s=answer["tick_s"],
    )
