"""Benchmark `joint-centers`: offsets of a detector's marks from the centres of joints, from captures with exact truth.

See ``pipeline.motion.skeleton.marks`` for the offsets: in the axes of the part of the body that carries a mark,
for each metre of the trunk. They are cross-validated over people: each person is corrected by what the other ones tell.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float

from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, require_writable, writing
from api.cli.options import checked, users_cache, with_choices
from pipeline.capture.session import open_session
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointOffset, JointOffsets
from pipeline.core.problems.finding_codes import DATASET_INCOMPLETE
from pipeline.motion.skeleton.marks import part_of_mark, trunk_length_m
from pipeline.motion.skeleton.model import joint_pose
from pipeline.run.engine.local import reconstruct
from pipeline.validation.evaluation.datasets.rendered import RenderedTruth, load_rendered
from pipeline.validation.evaluation.mpjpe import GATE_M

KINDS = ("shoulder", "hip", "ear", "nose")
"""Kinds of joints whose marks hang on a part of the body."""

# A mark farther from the true joint is a mistake of the detector, not an offset.
_LARGEST_OFFSET_M = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class MarkedPerson:
    """Marks of a person beside the true joints, of the kinds that were seen."""

    # Offset of each mark of a kind from its true joint in metres, (marks, 3): outwards, forward, up; without NaN
    offset_m: dict[str, Float[np.ndarray, "_ 3"]]
    trunk_m: float  # Length of the trunk between the marks


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Mean distance of a person's joints of a kind from the true ones, in millimetres."""

    person: int  # Number in the order in which people were given
    kind: str
    marked_mm: float
    corrected_mm: float  # After the offsets that the other people tell


def marked_people(reconstruction: Reconstruction, truth: RenderedTruth) -> list[MarkedPerson]:
    """Compare a reconstruction that was fitted without offsets with its truth.

    Each track is compared with the true person whose joints are nearest (median over frames and joints); tracks that
    are farther than 0.5 m from everybody are left out, and of several tracks of one person all but the longest.
    """
    timebase, joints = reconstruction.timebase, reconstruction.joints
    at = np.rint((truth.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    names = tuple(name for name in joints.names if name.rpartition("_")[2] in KINDS and name in truth.names)
    columns = np.array(joints.indices(names))
    true_m = truth.xyz_m[:, :, [truth.names.index(name) for name in names]]
    longest: dict[int, tuple[int, MarkedPerson]] = {}
    for track, motion in zip(reconstruction.animation.tracks, reconstruction.animation.motions, strict=True):
        instants = np.flatnonzero((at >= track.start_frame) & (at < track.start_frame + track.num_frames))
        rows = at[instants] - track.start_frame
        away_m = track.xyz_m[rows][:, columns] - true_m[:, instants]
        distance_m = np.linalg.norm(away_m, axis=-1).reshape(len(true_m), -1)
        is_known = np.isfinite(distance_m).any(-1)
        median_m = np.where(is_known, np.nanmedian(np.where(is_known[:, None], distance_m, 0.0), axis=-1), np.inf)
        person = int(np.argmin(median_m))
        if median_m[person] > GATE_M or longest.get(person, (0,))[0] >= len(rows):
            continue
        offset_m: dict[str, list[np.ndarray]] = {}
        for name, away in zip(names, np.moveaxis(away_m[person], 1, 0), strict=True):
            _, world_from_part = joint_pose(motion, part_of_mark(name))
            side, _, kind = name.rpartition("_")
            x, y, z = world_from_part[rows].inv().apply(away).T
            offset_m.setdefault(kind, []).append(
                np.stack([{"left": x, "right": -x}.get(side, 0.0 * x), -y, z], axis=-1)
            )
        kept = {kind: _near(np.concatenate(marks)) for kind, marks in offset_m.items()}
        seen = {kind: marks for kind, marks in kept.items() if len(marks)}
        longest[person] = len(rows), MarkedPerson(seen, trunk_length_m(motion.bone_length_m))
    return [marked for _, (_, marked) in sorted(longest.items())]


def _near(offset_m: Float[np.ndarray, "marks 3"]) -> Float[np.ndarray, "_ 3"]:
    return offset_m[np.linalg.norm(offset_m, axis=-1) < _LARGEST_OFFSET_M]  # NaN is not


def learn_offsets(people: Sequence[MarkedPerson], kinds: Sequence[str] = KINDS) -> JointOffsets:
    """Learn offsets: the mean over people of each one's median; kinds without a person are left out."""
    medians = {kind: [_median(person.offset_m[kind]) for person in people if kind in person.offset_m] for kind in kinds}
    means_m = {kind: np.mean(of_people, axis=0) for kind, of_people in medians.items() if of_people}
    # Of the trunk between the joints, which the marks make longer.
    longer_m = sum(sign * means_m[kind][2] for kind, sign in (("shoulder", 1.0), ("hip", -1.0)) if kind in means_m)
    trunk_m = float(np.mean([person.trunk_m for person in people])) - longer_m
    return {kind: JointOffset(*(round(float(part), 3) for part in mean / trunk_m)) for kind, mean in means_m.items()}


def _median(offset_m: Float[np.ndarray, "marks 3"]) -> Float[np.ndarray, " 3"]:
    return np.asarray(np.median(offset_m, axis=0))


def cross_validate(people: Sequence[MarkedPerson], kinds: Sequence[str] = KINDS) -> list[HeldOut]:
    """Correct each person by the offsets of all others, and measure what is left. Needs two people."""
    found = []
    for number, person in enumerate(people):
        offsets = learn_offsets([*people[:number], *people[number + 1 :]], kinds)
        longer = sum(sign * offsets[kind].up for kind, sign in (("shoulder", 1.0), ("hip", -1.0)) if kind in offsets)
        trunk_m = person.trunk_m / (1.0 + longer)
        for kind, marks_m in person.offset_m.items():
            offset = offsets.get(kind)
            moved_m = np.zeros(3) if offset is None else np.array([offset.outwards, offset.forward, offset.up])
            found.append(HeldOut(number, kind, _mean_mm(marks_m), _mean_mm(marks_m - trunk_m * moved_m)))
    return found


def _mean_mm(offset_m: Float[np.ndarray, "marks 3"]) -> float:
    return 1000.0 * float(np.linalg.norm(offset_m, axis=-1).mean())


@with_choices("profile", "joints", "detector")
def joint_centers(
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
