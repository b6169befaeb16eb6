"""Write the result files of a reconstruction; the service's results have the same names."""

import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.association.own_points.rigid import rigid_motions
from pipeline.calibration.write import encode as encode_calibration
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.arrays import short_text
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import PipelineError, Problem
from pipeline.core.options.arguments import checked
from pipeline.core.options.config import Body, JobChoices, Preset, Timeline
from pipeline.core.options.file_formats import FILE_FORMATS, Export, file_ending, formats_of_people, installed_formats
from pipeline.core.options.rules import file_problems, format_problems, require, value_problems
from pipeline.core.paths import StrPath
from pipeline.core.problems.finding_codes import TAKE_TOO_LARGE
from pipeline.core.problems.request_codes import VALUE_NOT_ALLOWED
from pipeline.core.progress import OnShare, ignore, split, sub_share
from pipeline.export import person_files
from pipeline.export.quality.force_checks import force_checks
from pipeline.export.quality.report import encode as encode_metrics
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.world_checks import failed_check
from pipeline.export.resample import resample
from pipeline.export.scene import file_origin_m, take_scene
from pipeline.export.timelines import held
from pipeline.export.writers import c3d_file, csv_table, force_tables, skeletons_json, trc
from pipeline.export.writers.angle_tables import BALANCE, balance_table, gait_tables
from pipeline.export.writers.registry import find_writer
from pipeline.motion.balance.compute import balance_of
from pipeline.motion.gait.analysis import analyse_gait
from pipeline.motion.skeleton.model import forward_kinematics

DEFAULT_EXPORTS: tuple[Export, ...] = JobChoices().exports
NOTHING_KEPT = person_files.KeptFiles()
ReportOf = Callable[[Reconstruction], dict[str, Any]]
OnFile = Callable[[Path], None]
"""Callback for the path of a result file that is complete."""
METRICS = "metrics.json"
TAKE = "take"
"""Name, without the ending, of the files with a whole take."""
OBJECTS = "objects"
"""Name, without the ending, of the files with the points of all objects."""
RIGID = "rigid.csv"
"""Name of the table with the poses of all rigid objects."""
CALIBRATION = "calibration.json"
"""Refined cameras, in the format that ``pipeline.calibration.write`` writes and every command reads."""

_DECIMALS_MM, _DECIMALS = 4, 4
# Units of the largest differences in files of numbers, by what the files hold.
_UNITS = {"angles": "_deg", "forces": "_si"}


def no_file(_: Path) -> None:
    """Report no file."""


@dataclass(frozen=True, slots=True)
class WrittenResults:
    """Result files of a take.

    Parameters
    ----------
    paths
        Files in the order in which they were completed.
    metrics
        Content of ``metrics.json``.

    Examples
    --------
    >>> WrittenResults((Path("person-1.bvh"),), {"people": []}).paths[0].suffix
    '.bvh'
    """

    paths: tuple[Path, ...]
    metrics: dict[str, Any]

    __repr__ = short_text


@checked
def write_results(
    reconstruction: Reconstruction,
    folder: StrPath,
    exports: Collection[Export] = DEFAULT_EXPORTS,
    preset: Preset = "default",
    frame_rate_hz: float | None = None,
    timeline: Timeline = "take",
    body: Body = "capsules",
) -> list[Path]:
    """Write all result files of a reconstruction into a folder, which is created if missing; return their paths.

    See ``write_files`` for the parameters. A Rerun recording has neither pictures nor detections without a
    person: a reconstruction does not hold them.

    Parameters
    ----------
    reconstruction
        Take to write.
    folder
        Folder of the files.
    exports, preset, frame_rate_hz, timeline, body
        See ``write_files``: formats, convention of BVH and FBX, rate in hertz, frames and body of each person's files.

    Returns
    -------
    list of Path
        Written files, ``metrics.json`` last.

    Raises
    ------
    InputError
        If there are more frames than result files, or one of the formats, may have, the package of a format is not
        installed, or a stage of its own writes it (``osim``).
    PipelineError
        If the folder can't be written to, the disk is full, or the content of a file differs from the written content.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> paths = multicap.write_results(multicap.reconstruct(session), folder / "written", exports=("csv",))
    >>> paths[-1].name
    'metrics.json'
    """
    folder = Path(folder)
    require(value_problems({"output_rate_hz": frame_rate_hz}))
    require((*format_problems(exports, installed_formats()), *_model_problems(exports)))
    try:
        recordings = _write_rerun(reconstruction, folder, exports)
        paths = write_files(reconstruction, folder, exports, preset, frame_rate_hz, timeline, body).paths
    except OSError as error:
        raise not_written(folder, error) from error
    return [*recordings, *paths]


def _write_rerun(take: Reconstruction, folder: Path, exports: Collection[Export]) -> list[Path]:
    """Write the Rerun recording of a take into a folder if it is wanted; return its path."""
    if "rerun" not in exports:
        return []
    from pipeline.export.rerun.rerun_file import write_rerun  # noqa: PLC0415 - imports an optional package

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{TAKE}.{file_ending('rerun')}"
    write_rerun(take, path)
    return [path]


def not_written(folder: Path, error: OSError) -> PipelineError:
    """Error of results that can't be written to a folder."""
    return PipelineError(f"The results can't be written to {folder}: {error.strerror or error}.")


def write_files(
    reconstruction: Reconstruction,
    folder: Path,
    exports: Collection[Export] = DEFAULT_EXPORTS,
    preset: Preset = "default",
    frame_rate_hz: float | None = None,
    timeline: Timeline = "take",
    body: Body = "capsules",
    on_share: OnShare = ignore,
    kept: person_files.KeptFiles = NOTHING_KEPT,
    report: ReportOf = quality_report,
    on_file: OnFile = no_file,
    on_forces: person_files.OnForces = person_files.no_forces,
) -> WrittenResults:
    """Write all result files into a folder, which is created if missing.

    Each file is written and read back under a temporary name, so that no incomplete file has its final name.
    Beside CSV files are tables of balance, and of events and strides of people who have some. ``calibration.json`` is
    written if the calibration was refined. ``metrics.json`` is the last file. It contains the largest distance, for
    each format, between joints read back and their true positions, the same half-way between two frames for files with
    angles, and the origin of files of single precision, if it is not the world's.

    - ``exports``: formats of the files of each person; others are left out. ``skeletons.json`` and ``metrics.json`` are
      always written.
    - ``frame_rate_hz``: rate of the motion in all files; ``None``: the session's rate. The figures in ``metrics.json``
      are always at the session's rate.
    - ``timeline``: frames of each person's files: all frames of the take, or the frames in which the person is there.
    - ``body``: body of the people in GLB, FBX and USD files.
    - ``on_share``: called with the progress while files are read back, and after each file.
    - ``kept``: files of people that were written before.
    - ``report``: makes the content of ``metrics.json``, after the people's files: its figures take much memory.
    - ``on_file``: called with the path of each file when it is complete.
    - ``on_forces``: called with the forces of each person at the session's rate, if they are among the exports.
    - Raises ``InputError`` if there are more frames than result files, or one of the formats, may have, or the package
      of a format is not installed.
    - Raises ``OSError`` if the folder can't be written to, the disk is full, or the content of a file differs from the
      written content.
    """
    timebase = reconstruction.timebase
    require(
        (
            *file_problems(exports, timebase.num_frames, timebase.frame_rate_hz, frame_rate_hz),
            *format_problems(exports, installed_formats()),
        )
    )
    exports, shown = formats_of_people(exports), at_rate(reconstruction, frame_rate_hz)
    folder.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []

    def complete(path: Path) -> None:
        paths.append(path)
        on_file(path)

    def keep(path: Path, pieces: Iterable[bytes]) -> None:
        with person_files.replacing(path, pieces) as part:
            _require_equal(part, path, pieces)
        complete(path)

    figures: list[dict[str, Any]] = []
    written: dict[str, dict[int, person_files.KeptFile]] = {name: {} for name in (person_files.SKELETONS, *exports)}
    on_people = split(sub_share(on_share, 0.0, 0.8), _num_frames(shown, timeline))
    with tempfile.TemporaryDirectory(prefix=".skeletons-", dir=folder) as tracks_folder:
        tracks = []
        for person, on_person in zip(
            person_files.take_people(shown, timeline, body, has_forces="forces" in exports), on_people, strict=True
        ):
            of_person = _paths(person, folder, Path(tracks_folder), exports)
            tracks.append(of_person[person_files.SKELETONS])
            for name, file in person_files.write_person(person, of_person, preset, kept, on_person):
                written[name][person.track.track_id] = file
                if name != person_files.SKELETONS:
                    complete(of_person[name])
            for path, pieces in _loads(person, folder) if "forces" in exports else ():
                keep(path, pieces)
            at_own_rate = [person] if "forces" in exports and shown is reconstruction else ()
            figures += person_files.force_figures(at_own_rate, on_forces)
        path = folder / "skeletons.json"
        with person_files.replacing(path, skeletons_json.join(shown, tracks)) as part:
            _require_equal(part, path, skeletons_json.join(shown, tracks))
    on_share(0.85)
    complete(path)
    of_takes = _TakeFiles(shown, folder, preset, body)
    for export, on_take in zip(exports, split(sub_share(on_share, 0.85, 0.95), [1] * len(exports)), strict=True):
        if of_takes.write(export, on_take):
            complete(of_takes.path(export))
        on_take(1.0)
    check = {
        name: _differences_in(people_files.values(), unit)
        if (unit := _UNITS.get(next((form.holds for export, form in FILE_FORMATS.items() if export == name), "")))
        else _found_in(people_files, of_takes.distances_mm.get(name))
        for name, people_files in written.items()
    }
    if (origin_m := file_origin_m(shown.cameras)).any():
        for export in filter(lambda export: find_writer(export).has_origin, exports):
            check[export]["origin_m"] = origin_m.tolist()
    tables = _tables(shown, folder) if "csv" in exports else ()
    for path, pieces in chain(tables, _object_files(shown, folder, exports)):
        keep(path, pieces)
    if reconstruction.refinement is not None and reconstruction.refinement.has_new_cameras:
        keep(folder / CALIBRATION, [encode_calibration(reconstruction.cameras)])
    at_session_rate = () if shown is reconstruction else person_files.take_people(reconstruction, timeline, body)
    asked = {"forces": figures or person_files.force_figures(at_session_rate, on_forces)} if "forces" in exports else {}
    metrics = _with_checks(report(reconstruction) | asked | {"exports": check}, shown, of_takes.too_large)
    path = folder / METRICS
    with person_files.replacing(path, [encode_metrics(metrics)]):
        pass
    on_share(1.0)
    complete(path)
    return WrittenResults(tuple(paths), metrics)


def _with_checks(metrics: dict[str, Any], take: Reconstruction, too_large: list[dict[str, Any]]) -> dict[str, Any]:
    """Content of ``metrics.json`` with findings about its files: too large ones, and forces that are missing."""
    of_forces = force_checks(take, metrics["forces"]) if "forces" in metrics else ()
    return metrics | {"capture_checks": [*metrics["capture_checks"], *too_large, *of_forces]}


def keep_people(
    reconstruction: Reconstruction,
    rows: slice,
    folder: Path,
    exports: Collection[Export],
    preset: Preset,
    frame_rate_hz: float | None,
    timeline: Timeline,
    body: Body,
    on_share: OnShare,
    kept: person_files.KeptFiles,
) -> None:
    """Write the files of some people into a folder and keep them, for ``write_files`` with the same choices.

    ``rows`` are the people's places among the tracks.
    """
    shown = at_rate(reconstruction, frame_rate_hz)
    of_take = person_files.take_people(shown, timeline, body, has_forces="forces" in exports)
    people = islice(of_take, rows.start, rows.stop, rows.step)
    on_people = split(on_share, _num_frames(shown, timeline)[rows])
    for person, on_person in zip(people, on_people, strict=True):
        paths = _paths(person, folder, folder, formats_of_people(exports))
        for _ in person_files.write_person(person, paths, preset, kept, on_person):
            pass
        for path in paths.values():
            path.unlink()


def _tables(take: Reconstruction, folder: Path) -> Iterator[tuple[Path, list[bytes]]]:
    """Path and content of each table beside people's CSV files: events, strides, balance."""
    for track, motion in zip(take.tracks, take.motions, strict=True):
        gait = analyse_gait(track, take.joints, take.timebase.frame_rate_hz)
        tables = [(kind, [content]) for kind, content in gait_tables(gait, take.timebase)]
        if (balance := balance_of(motion, track, take.joints, take.subject_of(track.track_id))) is not None:
            tables.append((BALANCE, list(balance_table(balance, take.timebase))))
        yield from ((folder / f"person-{track.track_id}.{kind}.csv", pieces) for kind, pieces in tables)


def _loads(person: person_files.PersonOfTake, folder: Path) -> Iterator[tuple[Path, list[bytes]]]:
    """Path and content of the files with external loads for OpenSim, and of the forces over strides."""
    forces = person.forces()
    if forces is not None:
        path = folder / f"person-{person.track.track_id}.forces.mot"
        yield path, list(force_tables.external_loads(forces, person.timebase, person.frames, path.name))
        yield path.with_suffix(".xml"), [force_tables.external_loads_setup(path.name, forces.mass)]
        strides = analyse_gait(person.track, person.joints, person.timebase.frame_rate_hz).strides
        if (cycles := force_tables.cycle_table(forces, strides)) is not None:
            yield folder / f"person-{person.track.track_id}.force_cycles.csv", [cycles]


def _object_files(
    take: Reconstruction, folder: Path, exports: Collection[Export]
) -> Iterator[tuple[Path, list[bytes]]]:
    """Path and content of each file with the points of all objects."""
    if "csv" in exports and (rigid := list(rigid_motions(take.own))):
        yield folder / RIGID, list(csv_table.encode_rigid(rigid, take.timebase))
    if take.own.scene is None:
        return
    points, track = take.own.scene
    paths = {export: folder / f"{OBJECTS}.{file_ending(export)}" for export in exports}
    if "csv" in paths:
        yield paths["csv"], list(csv_table.encode(track, points, take.timebase))
    if "trc" in paths:
        yield paths["trc"], list(trc.encode(track, points, take.timebase, paths["trc"].name))
    if "c3d" in paths:
        origin_m, shapes = file_origin_m(take.cameras), take.own.shapes
        yield paths["c3d"], list(c3d_file.encode(track, points, take.timebase, origin_m, shapes=shapes))


def _num_frames(take: Reconstruction, timeline: Timeline) -> list[int]:
    """Number of frames of the files of each person."""
    return [take.timebase.num_frames if timeline == "take" else track.num_frames for track in take.tracks]


def _model_problems(exports: Collection[Export]) -> Iterator[Problem]:
    """Find formats that a stage of their own writes."""
    for export in exports:
        if FILE_FORMATS[export].holds == "model":
            message = f"exports must not name {export} here: a stage of its own writes it."
            hint = "Use `reconstruct_to_files`, or `multicap reconstruct`."
            yield Problem(VALUE_NOT_ALLOWED, message, field="exports", hint=hint)


class _TakeFiles:
    """Files with a whole take, of the formats that have them; without people and objects there are none."""

    def __init__(self, take: Reconstruction, folder: Path, preset: Preset, body: Body) -> None:
        self._scene, self._folder, self._preset, self._body = take_scene(take), folder, preset, body
        self.distances_mm: dict[str, float] = {}  # Largest distance in the file of each format
        self.too_large: list[dict[str, Any]] = []  # Checks of files that their format does not allow

    def path(self, export: Export) -> Path:
        """Path of the file of a format."""
        return self._folder / f"{TAKE}.{file_ending(export)}"

    def write(self, export: Export, on_share: OnShare) -> bool:
        """Write the file of a format and read it back; return whether there is one."""
        form, scene, preset, path = find_writer(export).take, self._scene, self._preset, self.path(export)
        if form is None or not (scene.people or scene.objects):
            return False
        if not form.fits(scene):
            message = (
                f"{path.name} is left out: with {len(scene.people)} people it would be larger than its format allows."
            )
            self.too_large.append(failed_check(TAKE_TOO_LARGE, message))
            return False
        with person_files.replacing(path, form.encode(scene, preset, self._body)) as part:
            for number, (person, on_person) in enumerate(
                zip(scene.people, split(on_share, [1] * len(scene.people)), strict=True)
            ):
                expected_m = partial(_skeleton_m, person.motion)
                read_m = form.read(part, preset, number)
                distance_mm = person_files.furthest_mm(path, scene.frames, expected_m, read_m, on_person)
                if distance_mm is not None:
                    self.distances_mm[export] = max(self.distances_mm.get(export, 0.0), distance_mm)
        return True


def _skeleton_m(motion: SkeletonMotion, frames: range) -> Float[np.ndarray, "frames joints 3"]:
    """World positions (metres) of the skeleton's joints in some frames, of the nearest pose where there is none."""
    root_m, turns = (held(values, motion.frames, frames) for values in (motion.root_m, motion.parent_from_joint))
    return forward_kinematics(replace(motion, root_m=root_m, parent_from_joint=turns))


def at_rate(reconstruction: Reconstruction, frame_rate_hz: float | None) -> Reconstruction:
    """Reconstruction with the final motion at a rate; ``None``: as it is."""
    return reconstruction if frame_rate_hz is None else resample(reconstruction, frame_rate_hz)


def _paths(
    person: person_files.PersonOfTake, folder: Path, parts_folder: Path, exports: Collection[Export]
) -> dict[str, Path]:
    """Paths of a person's files by format, and of the part of ``skeletons.json``."""
    stem = f"person-{person.track.track_id}"
    of_files = {str(export): folder / f"{stem}.{file_ending(export)}" for export in exports}
    return {person_files.SKELETONS: parts_folder / f"{stem}.{person_files.SKELETONS}", **of_files}


def _require_equal(part: Path, path: Path, pieces: Iterable[bytes]) -> None:
    """Read a file back, piece by piece; ``OSError`` if it differs."""
    with part.open("rb") as file:
        if any(file.read(len(piece)) != piece for piece in pieces) or file.read(1):
            raise person_files.spoilt(path)


def _differences_in(files: Iterable[person_files.KeptFile], unit: str) -> dict[str, Any]:
    """Entry of ``metrics.json`` about the files of a format with joint angles, or with forces."""
    found = [file.difference for file in files if file.difference is not None]
    return {f"max_difference{unit}": round(max(found), _DECIMALS) if found else None}


def _found_in(people_files: Mapping[int, person_files.KeptFile], of_take_mm: float | None) -> dict[str, Any]:
    """Entry of ``metrics.json`` about the files of a format, by the number of the person's track.

    ``of_take_mm`` is the largest distance in the file of the take; ``None``: there is no such file.
    """
    found_mm = [*(file.distance_mm for file in people_files.values()), of_take_mm]
    distances_mm = [distance_mm for distance_mm in found_mm if distance_mm is not None]
    entry: dict[str, Any] = {"max_distance_mm": round(max(distances_mm), _DECIMALS_MM) if distances_mm else None}
    between = [(file.between, track_id) for track_id, file in people_files.items() if file.between is not None]
    if between:
        worst, track_id = max(between, key=lambda item: item[0].distance_mm)
        entry["between_frames"] = {
            "program": worst.program,
            "max_distance_mm": round(worst.distance_mm, _DECIMALS_MM),
            "person": track_id,
            "joint": worst.joint,
            "frame": worst.frame,
        }
    return entry
