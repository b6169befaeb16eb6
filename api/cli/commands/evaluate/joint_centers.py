"""`multicap evaluate joint-centers`: offsets of joint centres learnt from captures with exact truth."""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, require_writable, shows_help, writing
from api.cli.options import checked, with_choices
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.finding_codes import DATASET_INCOMPLETE

if not shows_help():
    from api.cli.console import users_cache
    from pipeline.capture.session import open_session
    from pipeline.run.engine.local import reconstruct
    from pipeline.validation.evaluation.datasets.rendered import load_rendered
    from pipeline.validation.evaluation.joint_centers import MarkedPerson, cross_validate, learn_offsets, marked_people


@with_choices("profile", "joints", "detector")
def command(
    *,
    data: Annotated[list[Path], typer.Option(help="A folder with videos/, calibration.toml and gt.npz; repeatable.")],
    chosen: Mapping[str, Any],
    out: Annotated[Path | None, typer.Option(help="JSON file of the offsets and of what they were learnt on.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Offsets of a detector's marks from true joint centres, cross-validated over people: each one left out in turn."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        config = replace(checked(chosen), joint_centers="off", force=True)
        require_writable(out)
        captures = [(folder, load_rendered(folder)) for folder in data]
        people: list[MarkedPerson] = []
        learnt_on = []
        for folder, truth in captures:
            session = open_session(folder / "videos", folder / "calibration.toml")
            marked = marked_people(reconstruct(session, config, bars.update, cache=users_cache()), truth)
            people += marked
            learnt_on.append({"data": folder.name, "people": len(marked), "instants": len(truth.time_s)})
        if len(people) < 2:
            message = f"Offsets are cross-validated over people, but {len(people)} of the truth was found."
            raise InputError([Problem(DATASET_INCOMPLETE, message, hint="Add captures with more people.")])
        held_out = cross_validate(people)
        offsets = {kind: asdict(offset) for kind, offset in learn_offsets(people).items()}
        report = {
            "networks": config.networks.names,
            "unit": "metres for each metre of the trunk",
            "offsets": offsets,
            "learnt_on": learnt_on,
            "held_out": [asdict(person) for person in held_out],
        }
        if out is not None:
            with writing(out):
                out.write_text(json.dumps(report, indent=2) + "\n")
    if as_json:
        emit(report)
        return
    print_table(
        ("person left out", "joint", "marked", "corrected"),
        (
            (str(row.person + 1), row.kind, f"{row.marked_mm:.1f} mm", f"{row.corrected_mm:.1f} mm")
            for row in sorted(held_out, key=lambda row: row.kind)
        ),
    )
    print_table(
        ("joint", "outwards", "forward", "up"),
        ((kind, *(f"{part:+.3f}" for part in parts.values())) for kind, parts in offsets.items()),
    )
