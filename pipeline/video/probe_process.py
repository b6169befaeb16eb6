"""Examine several video files, each in a child process (``pipeline.video.probe``) with limits."""

import json
import subprocess
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np

from pipeline.errors import Problem
from pipeline.runtime.child_processes import module_command, uninterrupted
from pipeline.video.children import READY, child_error, is_caused_by_file
from pipeline.video.info import Timecode, VideoInfo
from pipeline.video.probe import limits_problem, problem_before_opening, reading_s

_TIMEOUT_S = 120.0
_CHILDREN_AT_ONCE = 2
_LOOK_S = 0.5


def probe_in_children(paths: Sequence[Path]) -> list[VideoInfo | Problem]:
    """Examine video files, each in a child process with limits on time and memory.

    A file that makes FFmpeg crash, hang or exhaust memory ends only its own child. All children have ended when the
    function returns or raises, also on an interruption. Returns properties or problem of each file, in the order of
    ``paths``. Raises ``ChildError`` if a child fails for a reason other than its file.
    """
    running: set[subprocess.Popen[bytes]] = set()
    with ThreadPoolExecutor(_CHILDREN_AT_ONCE) as pool:
        waiting: list[Future[VideoInfo | Problem]] = []
        try:
            with uninterrupted():
                waiting += [pool.submit(_probe_in_child, path, running) for path in paths]
            # A signal that reached another thread wakes no thread that waits; its handler runs when this one looks.
            while wait(waiting, _LOOK_S, FIRST_EXCEPTION).not_done and not any(map(_is_failed, waiting)):
                pass
            return [future.result() for future in waiting]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            while not all(future.done() for future in waiting):
                for child in list(running):
                    child.kill()
                time.sleep(0.01)
            raise


def _is_failed(future: Future[VideoInfo | Problem]) -> bool:
    return future.done() and future.exception() is not None


def _probe_in_child(path: Path, running: set[subprocess.Popen[bytes]]) -> VideoInfo | Problem:
    if problem := problem_before_opening(path):
        return problem
    child = subprocess.Popen(  # noqa: S603 (our own interpreter and module)
        module_command("pipeline.video.probe", str(path.absolute())),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    running.add(child)
    timeout_s = _TIMEOUT_S + 2 * reading_s(path)
    try:
        output, errors = child.communicate(timeout=timeout_s)
        exit_code: int | None = child.returncode
    except subprocess.TimeoutExpired:
        child.kill()
        output, errors = child.communicate()
        exit_code = None
    finally:
        running.remove(child)
    if not output.startswith(READY) or (exit_code and not is_caused_by_file(exit_code)):
        raise child_error(f"check of {path.name}", exit_code, timeout_s, errors.decode(errors="replace"))
    if exit_code != 0:
        return limits_problem(path.name)
    answer = json.loads(output.removeprefix(READY))
    if "problem" in answer:
        return Problem(**answer["problem"])
    return VideoInfo(
        path=path,
        codec=answer["codec"],
        size_px=(answer["size_px"][0], answer["size_px"][1]),
        rotation_deg=answer["rotation_deg"],
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
