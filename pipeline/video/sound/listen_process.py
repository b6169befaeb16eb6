"""Listen to the sound of videos, each in a child process (``pipeline.video.sound.listen``) with limits."""

import json
import math
import subprocess

import numpy as np
from jaxtyping import Float32

from pipeline.core.data.arrays import read_only
from pipeline.core.runtime.child_processes import module_command
from pipeline.video.children import READY, child_environment, child_error, is_caused_by_file
from pipeline.video.info import VideoInfo
from pipeline.video.probe import reading_s

# Decoding takes far less than a twentieth of the sound's duration.
_BASE_CPU_S, _CPU_S_A_SECOND = 60, 0.05
_MS_A_SECOND = 1000


def listen_in_child(video: VideoInfo) -> Float32[np.ndarray, " ms"] | str:
    """Energy of each millisecond of a video's sound from its first frame on, or why there is none.

    A file that makes FFmpeg crash, hang or exhaust memory ends only its child, and has no sound then. Raises
    ``ChildError`` if the child fails for a reason other than its file.
    """
    if video.parts:
        return _listen_to_parts(video)
    if not len(video.pts) or video.path.is_dir() or video.path.suffix.lower() == ".zip":
        return "Images have no sound."
    max_cpu_s = _BASE_CPU_S + reading_s(video.path) + math.ceil(_CPU_S_A_SECOND * float(video.time_s[-1]))
    timeout_s = 2.0 * max_cpu_s
    arguments = [str(video.path.absolute()), str(int(video.pts[0])), str(max_cpu_s)]
    child = subprocess.Popen(  # noqa: S603 (our own interpreter and module)
        module_command("pipeline.video.sound.listen", *arguments),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=child_environment(),
    )
    try:
        output, errors = child.communicate(timeout=timeout_s)
        exit_code: int | None = child.returncode
    except subprocess.TimeoutExpired:
        child.kill()
        output, errors = child.communicate()
        exit_code = None
    except BaseException:
        child.kill()
        child.communicate()
        raise
    if exit_code is None or is_caused_by_file(exit_code):
        return "The sound can't be read within the limits on time and memory."
    if exit_code or not output.startswith(READY):
        raise child_error(
            f"reading of the sound of {video.path.name}", exit_code, timeout_s, errors.decode(errors="replace")
        )
    header, _, values = output.removeprefix(READY).partition(b"\n")
    answer = json.loads(header)
    if "reason" in answer:
        return str(answer["reason"])
    return read_only(np.frombuffer(values, np.float32))


def _listen_to_parts(video: VideoInfo) -> Float32[np.ndarray, " ms"] | str:
    """Energy of the sound of all files of a recording, each from its first frame on."""
    energies: list[np.ndarray] = []
    first = 0
    for part in video.parts:
        energy = listen_in_child(part)
        if isinstance(energy, str):
            return energy
        start_ms = round(_MS_A_SECOND * float(video.time_s[first]))
        # The sound of a file may be some milliseconds longer or shorter than its pictures.
        have_ms = sum(map(len, energies))
        energies.append(np.zeros(max(0, start_ms - have_ms), np.float32))
        energies.append(energy[max(0, have_ms - start_ms) :])
        first += part.num_frames
    return read_only(np.concatenate(energies))
