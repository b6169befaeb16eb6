"""Write files: the result files of a job. The output is their index, with the figures of ``metrics.json``.

*Writing edited people* leaves files of people as pieces, which *Writing files* finds again; its output is empty.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.core.findings import Finding
from pipeline.core.options.file_formats import FILE_FORMATS, file_ending
from pipeline.core.problems.finding_codes import EDIT_NOT_APPLIED, OPENSIM_FAILED
from pipeline.run.engine import stage

if TYPE_CHECKING:
    from pipeline.core.data.reconstruction import Reconstruction
    from pipeline.core.options.edited_take import EditedTake
    from pipeline.export.results import ReportOf
    from pipeline.motion.forces.person_forces import PersonForces

# Choices that decide about the files of people.
_CHOICES = ("exports", "preset", "output_rate_hz", "timeline", "body", "segments", "sex", "mass_kg")
# People, or edits, named by a warning.
_MAX_NAMED = 10
_XML = "application/xml"


@stage.declared(
    stage.WRITE,
    "Writing edited people",
    cut="people",
    follows=stage.TAKE,
    choices=_CHOICES,
    is_planned=lambda facts, config: config.making is None and bool(config.people_edits),
    is_of_edits=True,
    pieces_of=stage.EXPORT,
)
def write_people(task: stage.Task, context: stage.Context) -> stage.Output:
    """Write the files of a part of the people."""
    from pipeline.export.results import keep_people
    from pipeline.run.engine.pieces import FilesInPieces, Pieces
    from pipeline.run.engine.take import assemble

    config, pieces = context.config, Pieces(task, context)
    choices = config.exports, config.preset, config.output_rate_hz, config.timeline, config.body
    files = FilesInPieces(pieces, context.scratch)
    keep_people(assemble(context), write_people.people(task), context.scratch, *choices, context.on_share(task), files)
    return stage.Output(b"", pieces=pieces.files)


@stage.declared(
    stage.EXPORT,
    "Writing files",
    cut="whole",
    follows=(*stage.TAKE, stage.WRITE, stage.OPENSIM),
    choices=(*_CHOICES, "names"),
    is_planned=lambda facts, config: config.making is None,
    is_reusable=False,
    makes_files=True,
    pieces_of=stage.EXPORT,
)
def export(task: stage.Task, context: stage.Context) -> stage.Output:
    """Write the result files, and the files for viewers if they are wanted."""
    from pipeline.export.quality.report import all_checks, quality_report
    from pipeline.export.quality.views import person_views
    from pipeline.export.results import NOTHING_KEPT, write_files
    from pipeline.export.viewer.frames import force_arrows_m
    from pipeline.run.engine.edited_people import applied_edits
    from pipeline.run.engine.pieces import FilesInPieces, Pieces, TakeInPieces
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.take import assemble, viewer_files

    config, scratch, pieces = context.config, context.scratch, Pieces(task, context)
    reconstruction = assemble(context)
    kept = FilesInPieces(pieces, scratch) if context.files.keeps_pieces else NOTHING_KEPT
    views, take = cache(person_views), TakeInPieces(pieces, scratch, config.edits)
    report: "ReportOf" = partial(take.report, views=views) if context.files.keeps_pieces else quality_report
    if "osim" in config.exports:
        report = partial(_with_opensim, report, context)
    edited = applied_edits(context, found_people(context, stage.IDENTIFY).spans)
    report = partial(_with_edits, report, edited)
    choices = config.exports, config.preset, config.output_rate_hz, config.timeline, config.body
    arrows_m: dict[int, Any] = {}

    def keep_arrows(number: int, forces: "PersonForces") -> None:
        arrows_m[number] = force_arrows_m(forces)

    of_task = context.on_share(task), kept, report
    written = write_files(reconstruction, scratch, *choices, *of_task, on_forces=keep_arrows)
    names = {motion.track_id: motion.name for motion in reconstruction.motions}
    files = [_result_file(path, names) for path in written.paths]
    if context.files.has_viewers:
        first_frame = 0 if edited.frames is None else edited.frames.start

        def for_viewers() -> Sequence[stage.ResultFile]:
            footage = context.outline()
            # The files are kept whatever the names are, so they don't say which names could not be given.
            checks = [check for check in written.metrics["capture_checks"] if check["code"] != EDIT_NOT_APPLIED]
            shown = {**written.metrics, "capture_checks": checks}
            return viewer_files(reconstruction, views(reconstruction), footage, shown, scratch, first_frame, arrows_m)

        files += take.viewer_files(reconstruction, for_viewers) if context.files.keeps_pieces else for_viewers()
    warnings = tuple(all_checks(written.metrics))
    output = stage.indexed(files, metrics=written.metrics)
    return replace(output, warnings=warnings, people=found_people(context, stage.IDENTIFY).spans, pieces=pieces.files)


def _with_edits(report: "ReportOf", edited: "EditedTake", take: "Reconstruction") -> dict[str, Any]:
    """Content of ``metrics.json`` with warnings of the edits that are not applied."""
    content = report(take)
    problems = {
        number: outcome.problem for number, outcome in enumerate(edited.outcomes, 1) if outcome.problem is not None
    }
    findings = [
        Finding(EDIT_NOT_APPLIED, f"Edit {number} is not applied. {problem.message}", hint=problem.hint)
        for number, problem in list(problems.items())[:_MAX_NAMED]
    ]
    if len(problems) > _MAX_NAMED:
        message = f"{len(problems) - _MAX_NAMED} more edits are not applied."
        findings.append(Finding(EDIT_NOT_APPLIED, message, hint="Read the edits of the capture for this run."))
    return content | {"capture_checks": [*content["capture_checks"], *(finding.to_json() for finding in findings)]}


def _with_opensim(report: "ReportOf", context: stage.Context, take: "Reconstruction") -> dict[str, Any]:
    """Content of ``metrics.json`` with what OpenSim found of each person, and warnings of what it could not do."""
    found = [person for output in context.outputs(stage.OPENSIM) for person in json.loads(output)["people"]]
    people = sorted(found, key=lambda person: int(person["id"]))
    failed = [f"Person {person['id']}: {person['problem']}" for person in people if person["problem"]]
    content = report(take)
    checks = content["capture_checks"]
    if failed:
        more = f" And {len(failed) - _MAX_NAMED} more." if len(failed) > _MAX_NAMED else ""
        message = f"People without a motion of OpenSim. {' '.join(failed[:_MAX_NAMED])}{more}"
        checks = [*checks, Finding(OPENSIM_FAILED, message).to_json()]
    return content | {"opensim": people, "capture_checks": checks}


def _result_file(path: Path, names: Mapping[int, str]) -> stage.ResultFile:
    """Result file by its path; ``names`` are people's names by their numbers.

    A file of a format that is no person's is of the whole take.
    """
    stem, _, ending = path.name.partition(".")
    person = next((number for number in names if stem == f"person-{number}"), None)
    person_name = None if person is None else names[person]
    for name, file_format in FILE_FORMATS.items():
        if ending == file_ending(name):
            return stage.ResultFile(path.name, name, person, file_format.media_type, path, person_name)
    if person is not None:
        # Tables of events, strides and balance, and OpenSim's external loads.
        kind, _, form = ending.partition(".")
        media_type = {"csv": FILE_FORMATS["csv"].media_type, "mot": FILE_FORMATS["mot"].media_type}.get(form, _XML)
        return stage.ResultFile(path.name, kind, person, media_type, path, person_name)
    return stage.ResultFile(path.name, path.stem, None, "application/json", path)
