"""Files of a take's people on a character: GLB, BVH, FBX, and its bones with figures of each person."""

import json
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import PipelineError
from pipeline.core.options.config import Export, Timeline
from pipeline.core.progress import OnShare, ignore, part_of, split
from pipeline.export.character.figure import CharacterFigure
from pipeline.export.character.figures import figures_of
from pipeline.export.character.retarget import retarget
from pipeline.export.character.writers import character_bvh, character_fbx, character_glb
from pipeline.export.character.writers.posed import PosedCharacter, bone_places
from pipeline.export.person_files import furthest_mm, people_of, replacing
from pipeline.export.results import at_rate

DESCRIPTION = "character.json"
"""Name of the file with the bones of the character and figures of each person."""

_DECIMALS = 4


@dataclass(frozen=True, slots=True)
class CharacterResult:
    """A file of a person on a character."""

    path: Path
    export: Export  # Format
    track_id: int  # Number of the person


def write_character_files(
    take: Reconstruction,
    figure: CharacterFigure,
    folder: Path,
    exports: Collection[Export] = (),
    frame_rate_hz: float | None = None,
    timeline: Timeline = "take",
    on_share: OnShare = ignore,
) -> Iterator[CharacterResult]:
    """Retarget everybody of a take onto a character and write their files, ``character.json`` after them.

    Each file is written and read back under a temporary name, so that no incomplete file has its final name. GLB is
    always written, BVH and FBX if they are among the formats.

    Parameters
    ----------
    folder
        Folder of the files, which exists.
    exports
        Formats of the people's files; others than BVH and FBX don't count.
    frame_rate_hz
        Rate of the motion in the files; ``None``: the session's rate.
    timeline
        Frames of each person's files: all those of the take, or those in which the person is there.

    Yields
    ------
        Files when they are complete.

    Raises
    ------
    PipelineError
        If a person's GLB would be larger than its format allows.
    OSError
        If a file can't be written, the disk is full, or the content of a file differs from the written content.
    """
    shown = at_rate(take, frame_rate_hz)
    formats: tuple[Export, ...] = ("glb", *(export for export in exports if export in ("bvh", "fbx")))
    described: list[dict[str, Any]] = []
    people = list(people_of(shown, timeline, "capsules"))
    for person, on_person in zip(people, split(on_share, [len(person.frames) for person in people]), strict=True):
        motion = retarget(person.motion, figure, shown.animation.floor)
        posed = PosedCharacter(motion, person.motion.name, person.frames, person.is_present, person.origin_m)
        entry: dict[str, Any] = {"id": person.track.track_id, "name": person.motion.name, "units_per_m": motion.scale}
        figures = asdict(figures_of(motion))
        entry |= {name: _rounded(value) for name, value in figures.items()}
        entry["max_distance_mm"] = {}
        for export, on_file in zip(formats, split(on_person, [1] * len(formats)), strict=True):
            path = folder / f"person-{person.track.track_id}.character.{export}"
            entry["max_distance_mm"][export] = _rounded(_write(posed, export, path, part_of(on_file, 0.5, 1.0)))
            yield CharacterResult(path, export, person.track.track_id)
        described.append(entry)
    document = {**figure.mapping.document(), "file": figure.file.name, "people": described}
    with replacing(
        folder / DESCRIPTION, [json.dumps(document, indent=2, ensure_ascii=False).encode("utf-8", "replace")]
    ):
        pass
    on_share(1.0)


def _write(posed: PosedCharacter, export: Export, path: Path, on_read: OnShare) -> float | None:
    """Write a file of a person and read it back; returns the largest distance of a bone, in the person's mm."""
    names, scale = posed.motion.figure.rig.names, posed.motion.scale
    bones = character_bvh.depth_first(posed) if export == "bvh" else posed.bones()
    of_bones = tuple(names[node] for node in bones)
    match export:
        case "bvh":
            pieces = character_bvh.encode(posed)
        case "fbx":
            pieces = character_fbx.encode(posed)
        case _:
            if not character_glb.fits(posed):
                raise PipelineError(f"{path.name} would be larger than 4,096 MiB, which GLB does not allow.")
            pieces = character_glb.encode(posed)
    with replacing(path, pieces) as part:
        match export:
            case "bvh":
                read = character_bvh.read_xyz(part, scale, posed.origin_m)
            case "fbx":
                read = character_fbx.read_xyz(part, of_bones, scale)
            case _:
                read = character_glb.read_xyz(part, of_bones)
        return furthest_mm(path, posed.frames, partial(bone_places, posed, bones), read, on_read)


def _rounded(value: Any) -> Any:
    """Figures with four decimals; ``None`` for those that are not known."""
    if isinstance(value, (list, tuple)):
        return [_rounded(inner) for inner in value]
    return None if value is None or not isfinite(value) else round(float(value), _DECIMALS)
