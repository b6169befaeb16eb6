"""Figures of a character that follows a person: standing feet (slide, depth), kept contacts, directions of limbs."""

import json
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import PipelineError
from pipeline.core.options.config import Timeline
from pipeline.core.options.file_formats import Export
from pipeline.core.progress import OnShare, ignore, split, sub_share
from pipeline.export.character.bone_names import HIPS, LIMBS, SIDES
from pipeline.export.character.figure import CharacterFigure
from pipeline.export.character.limbs import ScaledFloor, level
from pipeline.export.character.retarget import CharacterMotion, node_place, retarget
from pipeline.export.character.writers import character_bvh, character_fbx, character_glb
from pipeline.export.character.writers.posed import PosedCharacter, bone_places
from pipeline.export.person_files import furthest_mm, replacing, take_people
from pipeline.export.results import at_rate
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from pipeline.motion.skeleton.rotations import times

KEPT_M = 0.005
"""Distance from its place, and from the floor, up to which a standing point keeps its contact."""

_CM_PER_M = 100.0


@dataclass(frozen=True, slots=True)
class RetargetingFigures:
    """Figures of a character's motion; lengths are in the person's world, NaN without any contact."""

    slide_cm: float  # Largest mean distance of a standing point from its place on the ground
    penetration_cm: float  # Largest depth of a sole below the floor while it stands
    contacts_kept: float  # Share of the frames of contacts in which the point is at its place
    # Angles between limbs of the character and of the person: median, 95th percentile
    direction_deg: tuple[float, float]
    # Angles between the hips of the character and of the person, likewise
    hips_deg: tuple[float, float]


def retargeting_figures(motion: CharacterMotion) -> RetargetingFigures:
    """Measure a character's motion."""
    joints = motion.figure.joints
    places = {
        joint: node_place(motion.figure, motion.hips, motion.turns, joints[joint]) for limb in LIMBS for joint in limb
    }
    slides, depths, kept = [0.0], [0.0], []
    for side in SIDES:
        if motion.floor is None:
            break
        contacts = [c for c in motion.source.contacts if c.pinned and c.side == side.lower()]
        apart_m, heights_m, is_upright = _sole_paths(motion, motion.floor, side, places[f"{side}Foot"], contacts)
        for contact, apart in zip(contacts, apart_m, strict=True):
            slides.append(float(apart.mean()))
            heights, upright = heights_m[contact.rows], is_upright[contact.rows]
            depths.append(float(-heights[upright].min(initial=0.0)))
            kept += ((apart <= KEPT_M) & ((np.abs(heights) <= KEPT_M) | ~upright)).tolist()
    person_m = forward_kinematics(_without_fingers(motion.source))
    deg = np.concatenate(
        [
            _angles_deg(places[end] - places[start], person_m[:, INDEX[end]] - person_m[:, INDEX[start]])
            for limb in LIMBS
            for start, end in pairwise(limb)
        ]
    )
    hips = motion.turns[joints[HIPS]] @ motion.figure.upright[joints[HIPS]].T
    person = Rotation.from_quat(motion.source.parent_from_joint[:, INDEX[HIPS]])
    tilt_deg = np.degrees((Rotation.from_matrix(hips, assume_valid=True) * person.inv()).magnitude())
    return RetargetingFigures(
        max(slides) * _CM_PER_M,
        max(depths) * _CM_PER_M,
        float(np.mean(kept)) if kept else np.nan,
        _median_and_high(deg),
        _median_and_high(tilt_deg),
    )


def _sole_paths(
    motion: CharacterMotion,
    floor: ScaledFloor,
    side: str,
    ankle: Float[np.ndarray, "frames 3"],
    contacts: list[FootContact],
) -> tuple[list[Float[np.ndarray, " _"]], Float[np.ndarray, " frames"], Bool[np.ndarray, " frames"]]:
    """Distances of the standing point from its place in each contact, heights of the sole, and feet not on their side.

    Lengths are in metres of the person.
    """
    foot, measures = motion.figure.joints[f"{side}Foot"], motion.figure.feet[side]
    turned = times(motion.turns[foot], motion.figure.upright[foot].T)
    ankle = ankle - motion.ground
    points = {"heel": ankle + times(turned, measures.heel), "toe": ankle + times(turned, measures.ball), "foot": ankle}
    heights = np.minimum(floor.height(points["heel"]), floor.height(points["toe"]))
    apart = []
    for contact in contacts:
        level_m = points[contact.part][contact.rows, :2] / motion.scale
        apart.append(np.linalg.norm(level_m - np.median(level_m, axis=0), axis=-1))
    return apart, heights / motion.scale, level(turned, floor)[1]


def _without_fingers(motion: SkeletonMotion) -> SkeletonMotion:
    size = len(SKELETON)
    return replace(
        motion, bone_length_m=motion.bone_length_m[:size], parent_from_joint=motion.parent_from_joint[:, :size]
    )


def angles_deg(motion: CharacterMotion, start: str, end: str) -> Float[np.ndarray, " frames"]:
    """Angles between a bone of the character and the person's, by the joints at its ends."""
    joints = motion.figure.joints
    places = [node_place(motion.figure, motion.hips, motion.turns, joints[name]) for name in (start, end)]
    places_m = forward_kinematics(motion.source)
    return _angles_deg(places[1] - places[0], places_m[:, INDEX[end]] - places_m[:, INDEX[start]])


def _angles_deg(
    first: Float[np.ndarray, "frames 3"], second: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, " frames"]:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(-1)))


def _median_and_high(deg: Float[np.ndarray, " angles"]) -> tuple[float, float]:
    return float(np.median(deg)), float(np.quantile(deg, 0.95))


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

    - ``folder``: folder of the files, which exists.
    - ``exports``: formats of the people's files; others than BVH and FBX don't count.
    - ``frame_rate_hz``: rate of the motion in the files; ``None``: the session's rate.
    - ``timeline``: frames of each person's files: all frames of the take, or the frames in which the person is there.
    - Yields files when they are complete.
    - Raises ``PipelineError`` if a person's GLB would be larger than its format allows.
    - Raises ``OSError`` if a file can't be written, the disk is full, or the content of a file differs from the written
      content.
    """
    shown = at_rate(take, frame_rate_hz)
    formats: tuple[Export, ...] = ("glb", *(export for export in exports if export in ("bvh", "fbx")))
    described: list[dict[str, Any]] = []
    people = list(take_people(shown, timeline, "capsules"))
    for person, on_person in zip(people, split(on_share, [len(person.frames) for person in people]), strict=True):
        motion = retarget(person.motion, figure, shown.animation.floor)
        posed = PosedCharacter(motion, person.motion.name, person.frames, person.is_present, person.origin_m)
        entry: dict[str, Any] = {"id": person.track.track_id, "name": person.motion.name, "units_per_m": motion.scale}
        figures = asdict(retargeting_figures(motion))
        entry |= {name: _rounded(value) for name, value in figures.items()}
        entry["max_distance_mm"] = {}
        for export, on_file in zip(formats, split(on_person, [1] * len(formats)), strict=True):
            path = folder / f"person-{person.track.track_id}.character.{export}"
            entry["max_distance_mm"][export] = _rounded(_write(posed, export, path, sub_share(on_file, 0.5, 1.0)))
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
