"""Archive of a person for OpenSim: markers, setups, the scaled model and its motion."""

import errno
import json
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.errors import printable
from pipeline.core.joints import JointSet
from pipeline.core.options.file_formats import file_ending
from pipeline.core.progress import OnShare, ignore, split
from pipeline.core.runtime.confinement import BeyondLimitsError, ChildLimits, FileRefusedError, run_confined
from pipeline.export.opensim import setup
from pipeline.export.opensim.installed import ATTRIBUTION, LICENCE_FILE, load
from pipeline.export.person_files import replacing, spoilt, without_resting_fingers
from pipeline.export.results import at_rate
from pipeline.export.scene import file_origin_m

# Longest silence of the child: the scale tool loads a model in a second, and reading an hour of markers takes a minute.
_TIMEOUT_S = 600.0
# Computing time, as a base and for each frame; a frame takes about 10 ms.
_MAX_CPU_S, _MAX_CPU_S_A_FRAME = 120, 0.25
_MAX_FILE_BYTES = 2**31
_MAX_OPEN_FILES = 256
_KEPT_CHARACTERS = 600
_FRAME = re.compile(
    r"Frame (?P<frame>\d+) \(t = (?P<time_s>\S+)\):.*"
    r"RMS = (?P<rms_m>\S+), max = (?P<max_m>\S+) \((?P<marker>[^)]*)\)"
)


@dataclass(slots=True)
class OpenSimLog:
    """Content of the log of a run."""

    # Marker that was farthest off in any frame, by how much, and when
    farthest: str | None = None
    farthest_m: float = 0.0
    farthest_time_s: float = 0.0
    # The same of the frame that was solved last
    last: str | None = None
    last_m: float = 0.0
    last_time_s: float = 0.0
    num_frames: int = 0  # Number of frames that were solved
    error: str = ""  # Last error


def run_opensim(folder: Path, num_frames: int, on_share: OnShare) -> tuple[OpenSimLog, str | None]:
    """Scale the model and run the inverse kinematics of the setups in a folder.

    ``num_frames``: number of frames of the markers. ``on_share``: called with the progress; an exception from it ends
    the child. Returns what the log says, and a sentence about what failed; ``None``: nothing did. Raises ``ChildError``
    if the child ends for a reason other than OpenSim, such as a signal from outside.
    """
    log, rest = OpenSimLog(), b""

    def follow(content: bytes) -> None:
        nonlocal rest
        *lines, rest = (rest + content).split(b"\n")
        for line in lines:
            _read_line(line.decode(errors="replace"), log)
        on_share(min(1.0, log.num_frames / num_frames))

    limits = ChildLimits(
        cpu_s=round(_MAX_CPU_S + _MAX_CPU_S_A_FRAME * num_frames),
        file_bytes=_MAX_FILE_BYTES,
        open_files=_MAX_OPEN_FILES,
    )
    try:
        run_confined(
            "pipeline.export.opensim.child",
            [str(folder.absolute())],
            limits,
            task="run of OpenSim",
            timeout_s=_TIMEOUT_S,
            on_output=follow,
        )
    except BeyondLimitsError:
        return log, f"OpenSim did not end within its limits on time and memory{_where(log)}."
    except FileRefusedError as error:
        return log, _failure(str(error), log)
    return log, None


def _read_line(line: str, log: OpenSimLog) -> None:
    """Take a line of the log into account."""
    if found := _FRAME.search(line):
        log.num_frames += 1
        log.last, log.last_m, log.last_time_s = found["marker"], float(found["max_m"]), float(found["time_s"])
        if log.last_m > log.farthest_m:
            log.farthest, log.farthest_m, log.farthest_time_s = log.last, log.last_m, log.last_time_s
    elif "[error]" in line:
        log.error = line.partition("[error]")[2].strip()


def _failure(errors: str, log: OpenSimLog) -> str:
    """Sentence about a step that failed."""
    report = json.loads(errors.strip().rpartition("\n")[2])
    step = "Scaling" if report["setup"] == "scale.xml" else "Inverse kinematics"
    # Exceptions of OpenSim have their text in the first lines, and then where in its sources they were thrown.
    reason = log.error or report["error"]
    short = printable(" ".join(reason.split()))[:_KEPT_CHARACTERS]
    return f"{step} failed{_where(log)}: {short}"


def _where(log: OpenSimLog) -> str:
    """Say which frame was solved last, and which marker was farthest off in it."""
    if log.last is None:
        return ""
    return f" after {log.last_time_s:g} s, where the marker {log.last} was {1000.0 * log.last_m:.0f} mm off"


REPORT, README = "report.json", "README.txt"

# Frames below which there is no motion to speak of.
_MIN_FRAMES = 2
_MM_PER_M = 1000.0
# Time of all members of an archive, the first that zips know: equal results are equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)
_LEAST_FREE_BYTES = 2**20
# OpenSim begins at its model's own place, and may not find people who are hundreds of metres away.
_NEAR_M = 20.0
# Errors of markers of a model that did not find the person.
_LOST_MM = 100.0


@dataclass(frozen=True, slots=True)
class OpenSimPerson:
    """Results of OpenSim for a person."""

    id: int
    num_frames: int  # Frames that the motion has: those in which the pelvis is known
    stature_m: float | None = None
    mass_kg: float | None = None
    # Root mean square of the errors of all markers over all frames
    marker_rms_mm: float | None = None
    # Marker that was farthest off in any frame, by how much, and when
    farthest_marker: str | None = None
    farthest_mm: float | None = None
    farthest_time_s: float | None = None
    problem: str | None = None  # Sentence about what is missing, and why; ``None``: nothing is

    def document(self) -> dict[str, Any]:
        """Figures as JSON, rounded."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in values.items()}


@dataclass(frozen=True, slots=True)
class WrittenPerson:
    """A person's archive."""

    path: Path | None  # ``None`` for a person without a frame that OpenSim could use
    person: OpenSimPerson


def write_opensim_files(
    take: Reconstruction,
    rows: slice,
    folder: Path,
    frame_rate_hz: float | None = None,
    on_share: OnShare = ignore,
) -> Iterator[WrittenPerson]:
    """Scale OpenSim's model to some people of a take, and write an archive for each.

    - ``rows``: people among the tracks.
    - ``folder``: folder of the archives, which exists; OpenSim works in a folder inside.
    - ``frame_rate_hz``: rate of the motion; ``None``: the session's rate.
    - ``on_share``: called with the progress.
    - Yields archives when they are complete. One in whose place there is a problem has no model or no motion.
    - Raises ``ModelError`` if the generic model is not installed, or was changed.
    - Raises ``ChildError`` if OpenSim is ended from outside.
    - Raises ``OSError`` if a file can't be written, or the disk is full.
    """
    model, licence = load()
    shown = at_rate(take, frame_rate_hz)
    people = list(zip(shown.tracks, shown.motions, strict=True))[rows]
    origin_m = file_origin_m(shown.cameras, _NEAR_M)
    for (track, motion), on_person in zip(
        people, split(on_share, [track.num_frames for track, _ in people]), strict=True
    ):
        with tempfile.TemporaryDirectory(prefix=".opensim-", dir=folder) as scratch:
            of_take = shown.joints, shown.timebase, origin_m, shown.subject_of(track.track_id)
            work = _Work(Path(scratch), f"person-{track.track_id}", track, motion, *of_take)
            yield work.write(folder, model, licence, on_person)
    on_share(1.0)


class _Work:
    """Work on a person in a folder of its own."""

    def __init__(
        self,
        scratch: Path,
        name: str,
        track: Track3D,
        motion: SkeletonMotion,
        joints: JointSet,
        timebase: Timebase,
        origin_m: Float[np.ndarray, " 3"],
        subject: Subject,
    ) -> None:
        self.scratch, self.name, self.timebase, self.motion, self.joints = scratch, name, timebase, motion, joints
        self.track, self.origin_m, self.subject = without_resting_fingers(track, joints), origin_m, subject

    def write(self, folder: Path, model: bytes, licence: bytes, on_share: OnShare) -> WrittenPerson:
        """Write a person's archive."""
        number = self.track.track_id
        size = setup.model_size(self.motion, self.track, self.joints, self.subject)
        paths = setup.marker_paths(self.motion, self.track, self.joints, size, self.origin_m)
        if len(paths.frames) < _MIN_FRAMES:
            problem = "Hips and shoulders are known together in fewer than two frames: OpenSim's model has no place."
            return WrittenPerson(None, OpenSimPerson(number, len(paths.frames), problem=problem))
        (self.scratch / setup.GENERIC_MODEL).write_bytes(model)
        (self.scratch / LICENCE_FILE).write_bytes(licence)
        self._write_setups(size, paths)
        person = self._run(size, paths, on_share)
        (self.scratch / README).write_text(_readme(person), encoding="utf-8")
        report = person.document() | {
            "factors": {body: [round(factor, 4) for factor in factors] for body, factors in size.factors.items()},
            "markers": list(paths.names),
            "origin_m": self.origin_m.tolist(),
        }
        (self.scratch / REPORT).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        target = folder / f"{self.name}.{file_ending('osim')}"
        with replacing(target, ()) as part:
            self._pack(part)
        return WrittenPerson(target, person)

    def _write_setups(self, size: setup.ModelSize, paths: setup.MarkerPaths) -> None:
        with (self.scratch / setup.MARKER_PATHS).open("wb") as file:
            file.writelines(setup.encode_paths(paths, self.timebase))
        for name, content in (
            (setup.MARKER_SET, setup.encode_marker_set(paths.names, size)),
            (setup.SCALE_SETUP, setup.encode_scale_setup(self.name, size)),
            (setup.IK_SETUP, setup.encode_ik_setup(self.name, paths, self.timebase)),
        ):
            (self.scratch / name).write_bytes(content)

    def _run(self, size: setup.ModelSize, paths: setup.MarkerPaths, on_share: OnShare) -> OpenSimPerson:
        """Run OpenSim, and read what it wrote."""
        number, num_frames = self.track.track_id, len(paths.frames)
        if odd := size.odd_bodies:
            of_bodies = ", ".join(f"{body} ({_factors_text(size, body)})" for body in odd)
            sentence = f"The model can't be scaled to bones of these lengths: {of_bodies} times the generic model."
            return OpenSimPerson(number, num_frames, size.stature_m, size.mass_kg, problem=sentence)
        log, problem = run_opensim(self.scratch, num_frames, on_share)
        rms_mm = self._read_back(num_frames) if problem is None else None
        if rms_mm is not None and rms_mm > _LOST_MM:
            problem = (
                f"The model is {rms_mm:.0f} mm from the markers, {log.farthest} farthest at {log.farthest_time_s:g} s."
            )
        self._require_space()
        return OpenSimPerson(number, num_frames, size.stature_m, size.mass_kg, rms_mm, *_farthest(log), problem)

    def _read_back(self, num_frames: int) -> float:
        """Read back what OpenSim has written; the RMS of the markers. ``OSError`` if it is not whole."""
        for name in (setup.SCALED_MODEL, setup.MOTION, setup.marker_errors_file(self.name)):
            path = self.scratch / name
            content = path.read_text(encoding="utf-8") if path.is_file() else ""
            if name == setup.SCALED_MODEL:
                is_whole = content.rstrip().endswith("</OpenSimDocument>")
            else:
                columns = setup.read_columns(content)
                is_whole = bool(columns) and all(
                    len(values) == num_frames and np.isfinite(values).all() for values in columns.values()
                )
            if not is_whole:
                self._require_space()
                raise spoilt(path)
        rms_m = columns["marker_error_RMS"]
        return _MM_PER_M * float(np.sqrt(np.mean(rms_m**2)))

    def _require_space(self) -> None:
        """Raise ``OSError`` if the disk is full: OpenSim does not say so."""
        if shutil.disk_usage(self.scratch).free < _LEAST_FREE_BYTES:
            raise OSError(errno.ENOSPC, "No space left on device")

    def _pack(self, target: Path) -> None:
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(self.scratch.iterdir()):
                info = zipfile.ZipInfo(f"{self.name}/{path.name}", _DATE)
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                with path.open("rb") as source, archive.open(info, "w") as packed:
                    shutil.copyfileobj(source, packed)


def _farthest(log: OpenSimLog) -> tuple[str | None, float | None, float | None]:
    if log.farthest is None:
        return None, None, None
    return log.farthest, _MM_PER_M * log.farthest_m, log.farthest_time_s


def _factors_text(size: setup.ModelSize, body: str) -> str:
    return " ".join(f"{factor:.2f}" for factor in dict.fromkeys(size.factors[body]))


def _readme(person: OpenSimPerson) -> str:
    """Text that tells what is in an archive, and how OpenSim is run on it."""
    found = f"Not complete: {person.problem}\n\n" if person.problem else ""
    return f"""Person {person.id} for OpenSim 4.

{found}{setup.MARKER_PATHS}  paths of the markers: metres, Y up; frames in which the pelvis is unknown are left out
{setup.GENERIC_MODEL}  generic model
{setup.MARKER_SET}  markers of the model
{setup.SCALE_SETUP}    setup of the scale tool: makes {setup.SCALED_MODEL}
{setup.SCALED_MODEL}   model of the size of the person
{setup.IK_SETUP}       setup of the inverse kinematics: makes {setup.MOTION}
{setup.MOTION}       coordinates of the model over time, degrees and metres
{REPORT}  stature, mass, factors of the bodies, errors of the markers

To run it again: load the setups in OpenSim's windows Scale Model and Inverse Kinematics, or start in this folder
  opensim-cmd run-tool {setup.SCALE_SETUP}
  opensim-cmd run-tool {setup.IK_SETUP}
or, with the Python package opensim, also in this folder:
  python -c "import opensim; opensim.ScaleTool('{setup.SCALE_SETUP}').run()"
  python -c "import opensim; opensim.InverseKinematicsTool('{setup.IK_SETUP}').run()"

{ATTRIBUTION}
Its terms are in {LICENCE_FILE}.
"""
