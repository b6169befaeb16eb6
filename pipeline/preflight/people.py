"""Check a session by the people whom its cameras see at a few instants: ``check_people`` is the whole way."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.data.cameras import Camera
from pipeline.findings import Finding, Severity
from pipeline.preflight.explain import (
    DOUBTFUL,
    MIN_INSTANTS,
    Hypothesis,
    PairDisagreement,
    as_given,
    explain,
    move_points,
)
from pipeline.preflight.sightings import SimultaneousPeople
from pipeline.preflight.world import check_world, locate, of_movers
from pipeline.problem_codes.findings import (
    CALIBRATION_OF_ANOTHER_RIG,
    CAMERA_SEES_NOBODY,
    CAMERAS_EXCHANGED,
    NO_COMMON_PEOPLE,
    NOBODY_DETECTED,
    PICTURE_MIRRORED,
    PICTURE_TURNED,
    SAME_VIDEO,
)
from pipeline.problem_codes.warnings import CAMERA_DISAGREES
from pipeline.quality.names import first_names

# Instants with the same points in two cameras that are no chance: detectors find the same in equal noise.
_MIN_SAME = 3
_OTHER_RIG = "Check that the calibration belongs to these videos, and that the videos are synchronised."


@dataclass(frozen=True, slots=True)
class PeopleCheck:
    """What people at a few instants tell of cameras."""

    findings: tuple[Finding, ...]
    num_located: int = 0  # Number of poses that pairs of agreeing cameras locate


def check_people(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> PeopleCheck:
    """Check whether cameras agree about people, and whether the world does.

    Cameras are in the order of the sightings. Findings have numbers as evidence.
    """
    seen = list(_check_anybody(cameras, sightings))
    if any(finding.code == NOBODY_DETECTED for finding in seen):
        return PeopleCheck(tuple(seen))
    if copies := list(_check_copies(cameras, sightings)):
        # The second camera of a copy has the wrong people, whatever its calibration.
        return PeopleCheck((*seen, *copies))
    evidence = PairDisagreement(cameras, sightings)
    given, best = as_given(len(cameras)), explain(evidence)
    disagreeing = list(_check_rest(cameras, evidence, best))
    explained = [*_exchanged(cameras, evidence, given, best), *_moved(cameras, evidence, given, best)]
    agreeing = [pair for pair, value in evidence.of_pairs(best, range(len(cameras))).items() if value <= DOUBTFUL]
    mended = _mended(cameras, sightings, best)
    rig = [cameras[place] for place in best.places]
    instants, poses_m = locate(rig, mended, agreeing)
    is_certain = sightings.num_independent(set(instants)) >= MIN_INSTANTS
    of_world = check_world(rig, of_movers(instants, poses_m), sightings.joints, is_certain)
    return PeopleCheck((*seen, *explained, *disagreeing, *of_world), len(poses_m))


def _check_anybody(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> Iterator[Finding]:
    counts = {camera.name: sightings.num_people(number) for number, camera in enumerate(cameras)}
    empty = [name for name, count in counts.items() if not count]
    num_instants = len(sightings.points_px[0])
    if len(counts) - len(empty) < 2:
        seeing = [name for name in counts if name not in empty]
        message = f"Nobody was detected in any camera at {num_instants} instants."
        if seeing:
            message = f"Only {seeing[0]} sees people at {num_instants} instants: nobody can be located from one camera."
        hint = (
            "See whether people are in the pictures, upright, bright and large enough. Choose a more exact profile, or "
            "another detector."
        )
        # A place may be empty at these instants, or all the time: an empty result is right then.
        yield Finding(NOBODY_DETECTED, message, None, "warning", hint, {"people": counts, "num_instants": num_instants})
        return
    for name in empty:
        message = f"Nobody was detected at {num_instants} instants, while other cameras see people."
        hint = "See whether the camera looks at the people, and whether its picture is upright, bright and sharp."
        yield Finding(CAMERA_SEES_NOBODY, message, name, "warning", hint, {"num_instants": num_instants})


def _check_copies(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> Iterator[Finding]:
    """Find cameras whose people are the same points as another camera's."""
    for left_camera, right_camera in itertools.combinations(range(len(cameras)), 2):
        pairs = [
            (left, right)
            for left, right in zip(sightings.points_px[left_camera], sightings.points_px[right_camera], strict=True)
            if left is not None and right is not None and len(left) + len(right)
        ]
        same = sum(left.shape == right.shape and np.array_equal(left, right, equal_nan=True) for left, right in pairs)
        if same >= _MIN_SAME and 2 * same > len(pairs):
            first = cameras[left_camera].name
            message = f"The people are the same points as those of {first}: one video or folder was given twice."
            evidence = {"other_camera": first, "num_same": same, "num_instants": len(pairs)}
            yield Finding(
                SAME_VIDEO, message, cameras[right_camera].name, "error", "Give each camera its own.", evidence
            )


def _exchanged(
    cameras: Sequence[Camera], evidence: PairDisagreement, given: Hypothesis, best: Hypothesis
) -> Iterator[Finding]:
    changed = [number for number, place in enumerate(best.places) if place != number]
    if not changed:
        return
    hint = (
        "Exchange the videos of these cameras, or their entries in the calibration. Give each video the name of its "
        "camera."
    )
    severity = evidence.certainty(changed, given)
    for number in changed:
        other = cameras[best.places[number]].name
        message = f"What {cameras[number].name} sees fits the calibration of {other}: cameras or videos are exchanged."
        yield Finding(
            CAMERAS_EXCHANGED,
            message,
            cameras[number].name,
            severity,
            hint,
            {"other_camera": other, **_disagreements(evidence, given, best, number)},
        )


def _moved(
    cameras: Sequence[Camera], evidence: PairDisagreement, given: Hypothesis, best: Hypothesis
) -> Iterator[Finding]:
    severity = evidence.certainty([number for number, move in enumerate(best.moves) if move != "as is"], given)
    for number, move in enumerate(best.moves):
        numbers = _disagreements(evidence, given, best, number)
        if move == "mirrored":
            message = "The picture is mirrored against its calibration: left is right."
            hint = "Turn off the mirroring of the camera, or mirror the video back."
            yield Finding(PICTURE_MIRRORED, message, cameras[number].name, severity, hint, numbers)
        elif move != "as is":
            message = f"The picture is turned by {move} degrees against its calibration."
            hint = f"Turn the video clockwise by {move} degrees, or calibrate the camera as it is turned."
            turned = {"turn_deg": int(move), **numbers}
            yield Finding(PICTURE_TURNED, message, cameras[number].name, severity, hint, turned)


def _disagreements(evidence: PairDisagreement, given: Hypothesis, best: Hypothesis, number: int) -> Mapping[str, float]:
    return {
        "disagreement": round(evidence.of_cameras(given)[number], 3),
        "disagreement_mended": round(evidence.of_cameras(best)[number], 3),
    }


def _check_rest(cameras: Sequence[Camera], evidence: PairDisagreement, best: Hypothesis) -> Iterator[Finding]:
    """Find cameras whose disagreement is not explained."""
    by_pair = evidence.of_pairs(best, range(len(cameras)))
    if by_pair and min(by_pair.values()) > DOUBTFUL:
        numbers = {"disagreement": round(float(np.mean(list(by_pair.values()))), 3), "num_pairs": len(by_pair)}
        message = "No two cameras agree about people: the calibration is that of another rig, or the clocks are wrong."
        severity: Severity = "error"
        if not evidence.is_clear(list(by_pair), best):
            message = (
                "No two cameras agree about most people: they see different people, or the calibration or the clocks "
                "are wrong."
            )
            severity = "warning"
        yield Finding(CALIBRATION_OF_ANOTHER_RIG, message, None, severity, _OTHER_RIG, numbers)
        return
    disagreeing = _disagreeing(by_pair)
    agreeing = [camera.name for number, camera in enumerate(cameras) if number not in disagreeing]
    for number, value in disagreeing.items():
        pairs = [pair for pair in by_pair if number in pair and not set(pair) & (disagreeing.keys() - {number})]
        is_clear = evidence.is_clear(pairs, best)
        others = f"elsewhere than {first_names(agreeing)} do"
        message = f"The camera sees {'people' if is_clear else 'many people'} {others}."
        hint = (
            "If the camera was moved, calibrate it again or refine the calibration (`refine_calibration`); else check "
            "its offset, and that its video and its calibration belong together."
        )
        yield Finding(
            CAMERA_DISAGREES,
            message,
            cameras[number].name,
            "error" if is_clear else "warning",
            hint,
            {"disagreement": round(value, 3)},
        )
    by_camera = evidence.of_cameras(best)
    for number, value in enumerate(by_camera):
        if np.isnan(value) and evidence.sees_people(number):
            message = "The camera sees people, but never at an instant at which another camera does."
            hint = "Check its offset, and that it looks at the same place as another camera."
            # The instants are few: at others the camera may see people together with others.
            yield Finding(NO_COMMON_PEOPLE, message, cameras[number].name, "warning", hint)


def _disagreeing(by_pair: Mapping[tuple[int, int], float]) -> Mapping[int, float]:
    """Cameras that disagree with the others, and their mean disagreement: the worst one is set aside, and so on."""
    worst_cameras: dict[int, float] = {}
    while True:
        left = {pair: value for pair, value in by_pair.items() if not set(pair) & worst_cameras.keys()}
        numbers = sorted({number for pair in left for number in pair})
        means = {
            number: float(np.mean([value for pair, value in left.items() if number in pair])) for number in numbers
        }
        worst = max(means, key=lambda number: means[number], default=None)
        if worst is None or means[worst] <= DOUBTFUL:
            return worst_cameras
        worst_cameras[worst] = means[worst]


def _mended(cameras: Sequence[Camera], sightings: SimultaneousPeople, best: Hypothesis) -> SimultaneousPeople:
    """Sightings with all points moved as they would fit."""
    for number, move in enumerate(best.moves):
        if move != "as is":
            moving = partial(move_points, move=move, size_px=cameras[number].size_px, joints=sightings.joints)
            sightings = sightings.moved(number, moving)
    return sightings
