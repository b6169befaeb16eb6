"""Check a session by the people in view at a few instants. Entry point: ``check_people``."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Finding, Severity
from pipeline.core.problems import finding_codes
from pipeline.export.quality.camera_shifts import find_shifted
from pipeline.export.quality.world_checks import first_names
from pipeline.run.session_check.consensus import CameraAgreement, LocatedPeople, locate_people, measure_agreement
from pipeline.run.session_check.explain import (
    DOUBTFUL,
    MIN_INSTANTS,
    Hypothesis,
    PairDisagreement,
    as_given,
    explain,
    move_points,
)
from pipeline.run.session_check.sightings import FAR, NUM_INSTANTS, SimultaneousPeople
from pipeline.run.session_check.world import check_world, locate, select_movers

# Instants with the same points in two cameras that are no chance: detectors find the same in equal noise.
_MIN_SAME = 3
_MOVED_CAMERA = (
    "If the camera was moved, calibrate it again or refine the calibration (`refine_calibration`); else check its "
    "offset, and that its video and its calibration belong together."
)
# Shift as a share of a person's size from which on a result will be wrong: epipolar distances are 2 / pi of it on
# average, as great as ``DOUBTFUL`` says.
_MAX_SHARE = np.pi / 2 * DOUBTFUL * FAR
_OTHER_RIG = "Check that the calibration belongs to these videos, and that the videos are synchronised."


@dataclass(frozen=True, slots=True)
class PeopleCheck:
    """Evidence about cameras from people at a few instants."""

    findings: tuple[Finding, ...]
    num_located: int = 0  # Number of poses that pairs of agreeing cameras locate


def check_people(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> PeopleCheck:
    """Check whether cameras agree about people, and whether the world does.

    Cameras are in the order of the sightings. Findings have numbers as evidence.
    """
    seen = list(_check_anybody(cameras, sightings))
    if any(finding.code == finding_codes.NOBODY_DETECTED for finding in seen):
        return PeopleCheck(tuple(seen))
    if copies := list(_check_copies(cameras, sightings)):
        # The second camera of a copy has the wrong people, whatever its calibration.
        return PeopleCheck((*seen, *copies))
    evidence, given = PairDisagreement(cameras, sightings), as_given(len(cameras))
    located, agreements = _agreements(cameras, sightings)
    doubted = [number for number, agreement in enumerate(agreements) if not agreement.agrees]
    best = explain(evidence, doubted)
    rig, mended = [cameras[place] for place in best.places], _mended(cameras, sightings, best)
    if best != given:
        located, agreements = _agreements(rig, mended)
    explained = [*_exchanged(cameras, evidence, given, best), *_moved(cameras, evidence, given, best)]
    disagreeing = list(_check_rest(rig, mended, evidence, best, located, agreements))
    is_agreed = located.is_view.sum(1) > 2
    for number in np.flatnonzero(~is_agreed):
        first, second = np.flatnonzero(located.is_view[number]).tolist()
        is_agreed[number] = evidence.pair_agreement(first, second, best).disagreement <= DOUBTFUL
    instants, poses_m = locate(rig, located.subset(is_agreed))
    is_certain = sightings.num_independent(set(instants)) >= MIN_INSTANTS
    of_world = check_world(rig, select_movers(instants, poses_m), sightings.joints, is_certain)
    return PeopleCheck((*seen, *explained, *disagreeing, *of_world), len(poses_m))


def _agreements(
    cameras: Sequence[Camera], sightings: SimultaneousPeople
) -> tuple[LocatedPeople, Sequence[CameraAgreement]]:
    """Locate the people, and compare each camera with the others."""
    located = locate_people(cameras, sightings)
    return located, [measure_agreement(camera, number, sightings, located) for number, camera in enumerate(cameras)]


def _check_anybody(cameras: Sequence[Camera], sightings: SimultaneousPeople) -> Iterator[Finding]:
    counts = {camera.name: sightings.num_people(number) for number, camera in enumerate(cameras)}
    empty = [name for name, count in counts.items() if not count]
    num_instants = len(sightings.points_px[0])
    if len(counts) - len(empty) < 2:
        seeing = [name for name in counts if name not in empty]
        message = f"No person was detected in any camera at {num_instants} instants."
        if seeing:
            message = f"Only {seeing[0]} sees people at {num_instants} instants: one camera can't locate a person."
        hint = (
            "See whether people are in the pictures, upright, bright and large enough. Choose a more exact profile, or "
            "another detector."
        )
        # A place may be empty at these instants, or all the time: an empty result is right then.
        numbers = {"people": counts, "num_instants": num_instants}
        yield Finding(finding_codes.NOBODY_DETECTED, message, None, "warning", hint, numbers)
        return
    for name in empty:
        message = f"No person was detected at {num_instants} instants, while other cameras see people."
        hint = "See whether the camera looks at the people, and whether its picture is upright, bright and sharp."
        yield Finding(finding_codes.CAMERA_SEES_NOBODY, message, name, "warning", hint, {"num_instants": num_instants})


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
            first, second = cameras[left_camera].name, cameras[right_camera].name
            message = f"The people are the same points as in {first}: one video or folder was given twice."
            evidence = {"other_camera": first, "num_same": same, "num_instants": len(pairs)}
            hint = "Give each camera its own."
            yield Finding(finding_codes.SAME_VIDEO, message, second, "error", hint, evidence)


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
        name, other = cameras[number].name, cameras[best.places[number]].name
        message = f"The people in {name} fit the calibration of {other}: cameras or videos are exchanged."
        numbers = {"other_camera": other, **_disagreements(evidence, given, best, number)}
        yield Finding(finding_codes.CAMERAS_EXCHANGED, message, name, severity, hint, numbers)


def _moved(
    cameras: Sequence[Camera], evidence: PairDisagreement, given: Hypothesis, best: Hypothesis
) -> Iterator[Finding]:
    severity = evidence.certainty([number for number, move in enumerate(best.moves) if move != "as is"], given)
    for number, move in enumerate(best.moves):
        if move == "as is":
            continue
        numbers = _disagreements(evidence, given, best, number)
        if move == "mirrored":
            message = "The picture is mirrored against its calibration: left is right."
            hint = "Turn off the mirroring of the camera, or mirror the video back."
            yield Finding(finding_codes.PICTURE_MIRRORED, message, cameras[number].name, severity, hint, numbers)
        elif move == "exchanged":
            message = "x and y of the keypoints are exchanged."
            hint = "Write x first: from the left of the picture to the right. y is from its top to its bottom."
            yield Finding(finding_codes.COORDINATES_EXCHANGED, message, cameras[number].name, severity, hint, numbers)
        else:
            message = f"The picture is turned by {move} degrees against its calibration."
            hint = f"Turn the video clockwise by {move} degrees, or calibrate the camera as it is turned."
            turned = {"turn_deg": int(move), **numbers}
            yield Finding(finding_codes.PICTURE_TURNED, message, cameras[number].name, severity, hint, turned)


def _disagreements(evidence: PairDisagreement, given: Hypothesis, best: Hypothesis, number: int) -> Mapping[str, float]:
    return {
        "disagreement": round(evidence.camera_agreements(given)[number], 3),
        "disagreement_mended": round(evidence.camera_agreements(best)[number], 3),
    }


def _check_rest(
    rig: Sequence[Camera],
    sightings: SimultaneousPeople,
    evidence: PairDisagreement,
    best: Hypothesis,
    located: LocatedPeople,
    agreements: Sequence[CameraAgreement],
) -> Iterator[Finding]:
    """Find cameras whose disagreement is not explained. The rig and the sightings are as they would fit."""
    names = evidence.names
    agreeing = [number for number, agreement in enumerate(agreements) if agreement.agrees]
    by_pair = {} if agreeing else evidence.pair_agreements(best, range(len(rig)))
    if by_pair and min(by_pair.values()) > DOUBTFUL:
        numbers = {"disagreement": round(float(np.mean(list(by_pair.values()))), 3), "num_pairs": len(by_pair)}
        message = "No two cameras agree about people: the calibration belongs to another rig, or the clocks are wrong."
        severity: Severity = "error"
        if not evidence.is_clear(list(by_pair), best):
            message = (
                "No two cameras agree about most people: they see different people, or the calibration or the clocks "
                "are wrong."
            )
            severity = "warning"
        yield Finding(finding_codes.CALIBRATION_OF_ANOTHER_RIG, message, None, severity, _OTHER_RIG, numbers)
        return
    is_enough = sightings.num_independent(set(located.instant.tolist())) >= MIN_INSTANTS
    elsewhere = [number for number, agreement in enumerate(agreements) if agreement.contradicts]
    trusted = agreeing or [number for number in range(len(rig)) if number not in elsewhere]
    listed: list[int] = []
    for number, agreement in enumerate(agreements):
        pairs = [(min(number, other), max(number, other)) for other in trusted if other != number]
        is_doubtful = not agreement.agrees and sightings.num_people(number) >= NUM_INSTANTS
        if number not in elsewhere and not (is_doubtful and evidence.disagrees(pairs, best)):
            continue
        listed.append(number)
        message = (
            f"The camera sees people elsewhere than {first_names([names[other] for other in trusted])} do: "
            f"{agreement.num_agreeing} of {agreement.num_compared} people agree."
        )
        numbers = {
            "num_agreeing": agreement.num_agreeing,
            "num_compared": agreement.num_compared,
            "chance": round(agreement.chance, 3),
        }
        severity = "error" if number in elsewhere and is_enough else "warning"
        yield Finding(finding_codes.CAMERA_DISAGREES, message, names[number], severity, _MOVED_CAMERA, numbers)
    for shift in find_shifted(rig, located.without_views(listed), located.instant):
        severity = "error" if shift.share > _MAX_SHARE and is_enough else "warning"
        yield Finding(
            finding_codes.CAMERA_DISAGREES, shift.message, names[shift.camera], severity, _MOVED_CAMERA, shift.evidence
        )
    for number in range(len(rig)):
        if not _has_company(sightings, number):
            message = "The camera sees people, but never at an instant at which another camera does."
            hint = "Check its offset, and that it looks at the same place as another camera."
            # The instants are few: at others the camera may see people together with others.
            yield Finding(finding_codes.NO_COMMON_PEOPLE, message, names[number], "warning", hint)


def _has_company(sightings: SimultaneousPeople, number: int) -> bool:
    """True if another camera sees people at an instant at which a camera does, if it ever does."""
    sees = np.array([[own is not None and len(own) > 0 for own in people] for people in sightings.points_px])
    return not sees[number].any() or bool((sees[number] & np.delete(sees, number, axis=0).any(0)).any())


def _mended(cameras: Sequence[Camera], sightings: SimultaneousPeople, best: Hypothesis) -> SimultaneousPeople:
    """Sightings with all points moved as they would fit."""
    for number, move in enumerate(best.moves):
        if move != "as is":
            moving = partial(move_points, move=move, size_px=cameras[number].size_px, joints=sightings.joints)
            sightings = sightings.moved(number, moving)
    return sightings
