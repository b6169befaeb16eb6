"""Check a character's file in a child process.

``python -m pipeline.export.character.check_character FILE [--bones TABLE]`` prints one JSON object: the character's
bones and facts about it, or ``{"problems": [...]}`` with exit code 2. So a caller can check a file of
a stranger without opening it, and without loading the numeric libraries.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import documents
from pipeline.core.problems.session_codes import CHARACTER_TOO_LARGE, CHARACTER_UNREADABLE
from pipeline.core.runtime.confinement import print_answer
from pipeline.export.character.bone_names import REQUIRED
from pipeline.export.character.figure import CharacterFigure, measure
from pipeline.export.character.mapping import map_bones, read_bone_table
from pipeline.export.character.source import read_character_file

MAX_CONTENTS_BYTES = 1 << 20
"""Largest size of what is said about a character: each answer about it has all of that."""

_DECIMALS = 4


def describe_character(path: Path, table: Path | None) -> dict[str, Any]:
    """Read a character and say what it contains, as JSON.

    ``table``: file of a table of bones; see ``pipeline.export.character.mapping.read_bone_table``. Raises
    ``InputError`` if the file or the table can't be used.
    """
    stated = {} if table is None else read_bone_table(table)
    file = read_character_file(path)
    if not np.isfinite(file.rig.worlds).all():
        message = "Places of bones are not finite numbers, once all nodes above them are applied."
        hint = "Apply the scales of the nodes above the bones before the export."
        raise InputError([Problem(CHARACTER_UNREADABLE, message, file=path.name, hint=hint)])
    figure = measure(file, map_bones(file, stated))
    mapping, rig = figure.mapping, figure.rig
    joints = [
        {
            "joint": joint,
            "bone": mapping.bones.get(joint),
            "recognised_by": mapping.recognised_by.get(joint),
            "is_required": joint in REQUIRED,
        }
        for joint in (*mapping.bones, *mapping.missing)
    ]
    contents = {
        "format": figure.file.format,
        "method": mapping.method,
        "stature": _stature(figure),
        "num_bones": int(rig.is_bone.sum()),
        "num_vertices": sum(len(skinned.positions) for skinned in figure.file.skinned),
        "joints": joints,
        "spine": list(mapping.spine),
        "neck": list(mapping.neck),
        "twists": dict(mapping.twists),
        "at_rest": list(mapping.at_rest),
        "warnings": documents(mapping.warnings),
        "skeleton": _skeleton(figure),
    }
    if len(json.dumps(contents)) > MAX_CONTENTS_BYTES:
        message = "The names of the bones are more than are kept."
        hint = "Leave out bones that are not the character's, or shorten their names."
        raise InputError([Problem(CHARACTER_TOO_LARGE, message, file=path.name, hint=hint)])
    return contents


def _stature(figure: CharacterFigure) -> float:
    """Height of the mesh in the rest pose, else of the bones, in the file's unit."""
    up = figure.skeleton_from_file[2]
    heights = [skinned.positions @ up for skinned in figure.file.skinned if len(skinned.positions)]
    heights = heights or [figure.positions[figure.rig.is_bone, 2]]
    return round(float(max(map(np.max, heights)) - min(map(np.min, heights))), _DECIMALS)


def _skeleton(figure: CharacterFigure) -> list[dict[str, Any]]:
    """Bones with the bone above each and their places in the rest pose, Z up, facing -Y; parents come first."""
    rig = figure.rig
    return [
        {
            "bone": rig.names[node],
            "parent": next((rig.names[above] for above in rig.ancestors(node)[1:] if rig.is_bone[above]), None),
            "position": [round(float(value), _DECIMALS) for value in figure.positions[node]],
        }
        for node in rig.order
        if rig.is_bone[node]
    ]


def main(words: Sequence[str] | None = None) -> int:
    """Run the check with the command line's arguments, or with ``words``; return the exit code."""
    parser = argparse.ArgumentParser(description="Check a character's file.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--bones", type=Path, help="Table of bones in JSON, which corrects what is recognised.")
    arguments = parser.parse_args(words)
    message = "The check of the file needs more memory than the service allows."
    too_large = Problem(CHARACTER_TOO_LARGE, message, hint="Leave out what is not the character.")
    return print_answer(lambda: describe_character(arguments.file, arguments.bones), too_large)


if __name__ == "__main__":
    sys.exit(main())
