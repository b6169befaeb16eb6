"""Checks of the capture: people were found, and enough cameras saw them.

Usual causes of a failed check are too few cameras, cameras with other fields of view, and a calibration of another
set-up, with which no two cameras agree on a person.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Bool

from pipeline.association.identity.likenesses import Likenesses, MirrorImage
from pipeline.core.data.cameras import Refinement, Synchronization
from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.people import PersonLoss
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.problems import finding_codes
from pipeline.export.quality.world_checks import failed_check, first_names
from pipeline.motion.skeleton.landmarks import MAX_ASYMMETRY, Landmarks, located_limbs_m
from pipeline.motion.skeleton.model import INDEX

_Failed = dict[str, Any]
_NAMES = {"ForeArm": "upper arm", "Hand": "forearm", "Leg": "thigh", "Foot": "shin"}


@dataclass(frozen=True, slots=True)
class MismeasuredLimb:
    """Limb of a person whose located length the fit does not use."""

    track_id: int  # Number of the person
    name: str  # Name of the limb, such as ``left forearm``
    located_m: float  # Median of the located lengths
    length_m: float  # Length of the skeleton's bone

    @property
    def document(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "person": self.track_id,
            "limb": self.name,
            "located_m": round(self.located_m, 3),
            "length_m": round(self.length_m, 3),
        }


def mismeasured_limbs(take: Reconstruction, people: Sequence[int]) -> list[MismeasuredLimb]:
    """Find the limbs whose located length differs from the skeleton's by more than bodies and marks explain.

    ``people`` are positions of tracks: pictures of people have limbs of any length.
    """
    limbs = []
    for number in people:
        track, motion = take.located[number], take.motions[number]
        located_m = located_limbs_m(Landmarks(track.xyz_m, track.source, take.joints, track.views))
        for (side, kind), median_m in located_m.items():
            length_m = float(motion.bone_length_m[INDEX[f"{side.capitalize()}{kind}"]])
            shorter_m, longer_m = sorted((median_m, length_m))
            if longer_m > (1.0 + MAX_ASYMMETRY) * shorter_m:
                limbs.append(MismeasuredLimb(track.track_id, f"{side} {_NAMES[kind]}", median_m, length_m))
    return limbs


# With fewer views, a wrong observation can't be detected.
_MIN_VIEWS = 3
# Confidence in the identity of a person below which the user should look.
_UNCERTAIN = 0.9
_SHOWN_TIMES = 5
# A single doubled picture does no harm.
_MAX_DOUBLED = 0.01
# Findings that explain an empty result, and are no errors: places may be empty.
_OF_NOBODY = frozenset({"nobody_detected", "no_common_people"})
# Findings that a message quotes.
_MAX_REASONS = 3


def capture_checks(
    reconstruction: Reconstruction, seen: Mapping[int, Bool[np.ndarray, "frames cameras"]], likenesses: Likenesses
) -> list[dict[str, Any]]:
    """List the failed checks of the capture as findings.

    ``seen`` is whether a camera saw any joint of the person in a frame, by track.
    """
    names = [camera.name for camera in reconstruction.cameras]
    numbers, accepts = [track.track_id for track in reconstruction.tracks], reconstruction.accepts
    limbs = [
        limb
        for limb in mismeasured_limbs(reconstruction, likenesses.others(len(reconstruction.motions)))
        if not accepts(finding_codes.LIMB_MISMEASURED, limb.track_id)
    ]
    still = [p for p in likenesses.still if not accepts(finding_codes.PERSON_NEVER_MOVES, numbers[p.number])]
    images = [p for p in likenesses.images if not accepts(finding_codes.MIRROR_IMAGE, numbers[p.number])]
    likenesses = Likenesses(still, images)
    used = np.any([frames.any(0) for frames in seen.values()], axis=0) if seen else np.ones(len(names), bool)
    unused = [
        name
        for name, is_used in zip(names, used, strict=True)
        if not is_used and not accepts(finding_codes.CAMERA_WITHOUT_PEOPLE, camera=name)
    ]
    checks = (
        _check_rig(names),
        _check_videos(reconstruction.damaged),
        _check_doubled(reconstruction.damaged),
        _check_people(seen, reconstruction),
        _check_cameras(unused),
        _check_views(names, {number: sees for number, sees in seen.items() if not accepts("few_views", number)}),
        _check_association(reconstruction),
        _check_identity(reconstruction),
        _check_losses(reconstruction),
        _check_limbs(limbs),
        _check_still(reconstruction, likenesses),
        _check_images(reconstruction, likenesses),
        _check_refinement(reconstruction.refinement),
        _check_synchronization(reconstruction.synchronization),
    )
    return [*chain.from_iterable(checks)]


def _check_rig(names: list[str]) -> Iterator[_Failed]:
    if 0 < len(names) < _MIN_VIEWS:
        yield failed_check(
            finding_codes.TOO_FEW_CAMERAS,
            f"The capture has {len(names)} cameras. With fewer than {_MIN_VIEWS}, errors can't be detected.",
        )


def _check_doubled(videos: Sequence[DamagedVideo]) -> Iterator[_Failed]:
    described = [
        f"{video.file} ({len(video.doubled_s)} of {video.num_frames} frames, {_times(video.doubled_s)})"
        for video in videos
        if len(video.doubled_s) > max(1, _MAX_DOUBLED * video.num_frames)
    ]
    if described:
        yield failed_check(
            finding_codes.FRAMES_DOUBLED,
            f"Frames show the picture before once more in {first_names(described)}. People lag behind by a frame "
            "there; record with a camera that keeps its rate, or export without a constant rate.",
        )


def _times(time_s: Sequence[float]) -> str:
    more = len(time_s) - _SHOWN_TIMES
    return f"at {', '.join(f'{second:.2f}' for second in time_s[:_SHOWN_TIMES])} s" + (
        f" and {more} more" if more > 0 else ""
    )


def _check_videos(videos: Sequence[DamagedVideo]) -> Iterator[_Failed]:
    damaged = [video for video in videos if video.num_damaged]
    if not damaged:
        return
    described = [
        f"{video.file} ({video.num_damaged} of {video.num_frames} frames, "
        f"from {video.first_s:.1f} to {video.last_s:.1f} s)"
        for video in damaged
    ]
    subject = "A video is" if len(damaged) == 1 else f"{len(damaged)} videos are"
    yield failed_check(
        finding_codes.DAMAGED_VIDEO,
        f"{subject} damaged: {first_names(described)}. People may be wrong or missing there, and up to the video's "
        "next keyframe.",
    )


def _check_people(seen: Mapping[int, np.ndarray], take: Reconstruction) -> Iterator[_Failed]:
    if seen:
        return
    if take.is_emptied:
        yield failed_check(
            finding_codes.EVERYBODY_REMOVED,
            "The edits removed all people. Undo an edit to restore them.",
        )
        return
    check = take.check
    errors = list(_reasons(check))
    if take.own.objects and not errors and not any(check.people.values()):
        return  # a take of animals
    reason = (
        "Check that the calibration belongs to these videos, that the videos are synchronised, and that at least two "
        "cameras see the same person."
    )
    if errors:
        reason = " ".join(str(finding) for finding in errors[:_MAX_REASONS])
    elif any(check.people.values()):
        people = first_names([f"{count} in {camera}" for camera, count in check.people.items()])
        detected = f"People were detected ({people}, at {check.num_instants} instants)"
        reason = f"{detected}, but not matched across cameras. {reason}"
    not_matched = "not_matched" if any(check.people.values()) else "unknown"
    measured = {"people": dict(check.people), "num_instants": check.num_instants}
    why = {"reason": errors[0].code if errors else not_matched, **measured}
    yield failed_check(finding_codes.NOBODY_FOUND, f"No person was found. {reason}", why)


def _reasons(check: SessionCheck) -> Iterator[Finding]:
    """Findings that explain why no person was found."""
    return (finding for finding in check.findings if finding.severity == "error" or finding.code in _OF_NOBODY)


def _check_cameras(unused: Sequence[str]) -> Iterator[_Failed]:
    message = (
        f"No person was matched in {len(unused)} cameras: {first_names(unused)}. Their videos, calibrations or timing "
        "may be wrong."
    )
    if len(unused) == 1:
        message = f"No person was matched in {unused[0]}: its video, calibration or timing may be wrong."
    if unused:
        yield failed_check(finding_codes.CAMERA_WITHOUT_PEOPLE, message, {"cameras": unused})


def _check_views(names: list[str], seen: Mapping[int, np.ndarray]) -> Iterator[_Failed]:
    if len(names) < _MIN_VIEWS:
        return
    people = [f"person-{track_id}" for track_id, frames in seen.items() if _has_few_views(frames)]
    if len(people) == 1:
        yield failed_check(
            finding_codes.FEW_VIEWS, f"{people[0]} was seen by fewer than {_MIN_VIEWS} cameras in most frames."
        )
    elif people:
        yield failed_check(
            finding_codes.FEW_VIEWS,
            f"{len(people)} people were seen by fewer than {_MIN_VIEWS} cameras in most frames: {first_names(people)}.",
        )


def _check_association(reconstruction: Reconstruction) -> Iterator[_Failed]:
    if reconstruction.num_approximate_frames:
        yield failed_check(
            finding_codes.APPROXIMATE_ASSOCIATION,
            f"In {reconstruction.num_approximate_frames} of {reconstruction.timebase.num_frames} frames there were too "
            "many people for an exact matching: a simpler rule matched them.",
        )


def _check_identity(reconstruction: Reconstruction) -> Iterator[_Failed]:
    doubtful = [
        (track.track_id, min(of_person, key=lambda doubt: doubt.confidence))
        for track, of_person in zip(reconstruction.tracks, reconstruction.doubts, strict=False)
        if any(doubt.confidence < _UNCERTAIN for doubt in of_person)
    ]
    if doubtful:
        described = [f"person-{track_id} (frame {doubt.frame})" for track_id, doubt in doubtful]
        yield failed_check(
            finding_codes.UNCERTAIN_IDENTITY,
            f"Some people may be confused: {first_names(described)}. Look at these moments; `identity.doubts` in "
            "metrics.json lists all of them.",
        )


def _check_losses(take: Reconstruction) -> Iterator[_Failed]:
    vanished = [_describe_loss(loss) for loss in take.losses if loss.kind == "vanished"]
    if vanished:
        subject = "A person vanishes" if len(vanished) == 1 else "People vanish"
        yield failed_check(
            finding_codes.PERSON_LOST,
            f"{subject} in the middle of the room, where cameras view the place: {first_names(vanished)}. The person "
            "is hidden there, or was not detected or not matched.",
            _measured_losses(take, "vanished"),
        )
    phantoms = [_describe_loss(loss) for loss in take.losses if loss.kind == "phantom"]
    if phantoms:
        yield failed_check(
            finding_codes.PHANTOM_ENDED,
            f"A track was made of other people's limbs, and these frames were taken from it: {first_names(phantoms)}.",
            _measured_losses(take, "phantom"),
        )


def _describe_loss(loss: PersonLoss) -> str:
    person = f"person-{loss.track_id}" if loss.track_id else "a track that ended"
    x_m, y_m, _ = loss.place_m
    return f"{person} (frames {loss.start_frame} to {loss.stop_frame - 1}, at x {x_m:.1f} m, y {y_m:.1f} m)"


def _measured_losses(take: Reconstruction, kind: str) -> dict[str, Any]:
    return {
        "people": [
            {
                "person": loss.track_id or None,
                "start_frame": loss.start_frame,
                "num_frames": loss.stop_frame - loss.start_frame,
                "place_m": list(loss.place_m),
            }
            for loss in take.losses
            if loss.kind == kind
        ]
    }


def _check_limbs(limbs: Sequence[MismeasuredLimb]) -> Iterator[_Failed]:
    if limbs:
        described = [
            f"{limb.name} of person-{limb.track_id} ({1000 * limb.located_m:.0f} mm, used are "
            f"{1000 * limb.length_m:.0f} mm)"
            for limb in limbs
        ]
        yield failed_check(
            finding_codes.LIMB_MISMEASURED,
            f"A limb was located with a wrong length in most frames: {first_names(described)}. The length in "
            "use comes from other frames and the body's proportions. The limb may be hidden.",
            {"limbs": [limb.document for limb in limbs]},
        )


def _check_still(take: Reconstruction, likenesses: Likenesses) -> Iterator[_Failed]:
    people = [
        f"person-{take.tracks[person.number].track_id} (by {100 * person.moved_m:.1f} cm at most in "
        f"{person.num_frames} frames)"
        for person in likenesses.still
    ]
    if people:
        subject = "A person never moves" if len(people) == 1 else f"{len(people)} people never move"
        yield failed_check(
            finding_codes.PERSON_NEVER_MOVES,
            f"{subject}: {first_names(people)}. It may be a picture, a mannequin or a "
            "sleeping person. The floor and the refined calibration ignore it, and a limit of people drops it first.",
            {
                "people": [
                    {
                        "person": take.tracks[person.number].track_id,
                        "moved_m": round(person.moved_m, 4),
                        "num_frames": person.num_frames,
                    }
                    for person in likenesses.still
                ]
            },
        )


def _check_images(take: Reconstruction, likenesses: Likenesses) -> Iterator[_Failed]:
    images = [
        f"person-{take.tracks[image.number].track_id} mirrors person-{take.tracks[image.original].track_id} to "
        f"{100 * image.error_m:.1f} cm in {image.num_frames} frames, in the plane {_plane(image)}"
        for image in likenesses.images
    ]
    if images:
        subject = "A person is the mirror image of another one" if len(images) == 1 else "People are mirror images"
        yield failed_check(
            finding_codes.MIRROR_IMAGE,
            f"{subject}: {first_names(images)}. The floor and the refined calibration ignore images, "
            "and a limit of people drops them first.",
            {
                "people": [
                    {
                        "person": take.tracks[image.number].track_id,
                        "mirrors": take.tracks[image.original].track_id,
                        "normal": [round(float(value), 4) + 0.0 for value in image.normal],
                        "offset_m": round(image.offset_m, 4),
                        "error_m": round(image.error_m, 4),
                        "num_frames": image.num_frames,
                    }
                    for image in likenesses.images
                ]
            },
        )


def _plane(image: MirrorImage) -> str:
    """Equation of a mirror's plane, such as ``1.00 x + 0.00 y + 0.00 z = 2.60 m``."""
    x, y, z = (float(value) + 0.0 for value in np.round(image.normal, 2))
    return f"{x:.2f} x {y:+.2f} y {z:+.2f} z = {image.offset_m:.2f} m"


def _check_refinement(refinement: Refinement | None) -> Iterator[_Failed]:
    if refinement is None:
        return
    errors = f"{refinement.error_before_px:.1f} px", f"{refinement.error_after_px:.1f} px"
    if refinement.refined:
        moves = [
            f"{move.camera} by {move.moved_px:.1f} px in its picture ({move.rotation_deg:.1f} degrees, "
            f"{100 * move.translation_m:.1f} cm)"
            for move in refinement.moved
        ]
        yield failed_check(
            finding_codes.CALIBRATION_REFINED,
            f"The calibration did not fit the people: {errors[0]}. It was refined to {errors[1]}. Cameras moved, the "
            f"largest move first: {first_names(moves)}. Use calibration.json for takes of the same cameras.",
        )
    else:
        yield failed_check(
            finding_codes.CALIBRATION_KEPT,
            f"The calibration was not refined, and is used as given. {_why_kept(refinement, *errors)}",
        )
    if refinement.world is not None:
        yield failed_check(
            finding_codes.WORLD_LEVELED,
            f"The floor was tilted by {refinement.world.tilt_deg:.1f} degrees and at a height of "
            f"{refinement.world.height_m:.2f} m. The world was levelled: feet stand at z = 0. Use calibration.json for "
            "takes of the same cameras.",
        )
    if refinement.bumped:
        bumps = [
            f"{bump.camera} from {_minutes(bump.time_s)} on ({bump.rotation_deg:.1f} degrees)"
            for bump in refinement.bumped
        ]
        yield failed_check(
            finding_codes.CAMERA_BUMPED,
            f"A camera was moved during the take: {first_names(bumps)}. Reconstruct the frames before and after it on "
            "their own.",
        )


def _why_kept(refinement: Refinement, before: str, after: str) -> str:
    """Sentences that say why a calibration was not refined."""
    if refinement.refusal == "few_people":
        return (
            f"Cameras share {refinement.num_points} joints of people, too few to compare the cameras: let people walk "
            "where several cameras see them."
        )
    if refinement.refusal == "undetermined" or refinement.most_moved is None:
        return f"The people, at {before}, determine no camera: let them walk all over the place, for a minute."
    most = refinement.most_moved
    return (
        f"Cameras that fit the people change the error from {before} to {after}, as errors of a detector may, too. "
        f"{most.camera} would move most, by {most.moved_px:.1f} px in its picture ({most.rotation_deg:.1f} degrees)."
    )


def _check_synchronization(synchronization: Synchronization | None) -> Iterator[_Failed]:
    if synchronization is not None and synchronization.warnings:
        described = [f"{warning.camera}: {warning.message.rstrip('.')}" for warning in synchronization.warnings]
        yield failed_check(
            finding_codes.SYNC_UNCERTAIN,
            f"The clocks of the cameras were measured, but not well: {first_names(described)}. Let a person move "
            "where all cameras see them.",
        )


def _minutes(time_s: float) -> str:
    """Minutes and seconds, such as 02:14."""
    return f"{int(time_s) // 60:02d}:{int(time_s) % 60:02d}"


def _has_few_views(frames: Bool[np.ndarray, "frames cameras"]) -> bool:
    views = frames.sum(-1)
    views = views[views > 0]
    return bool(2 * np.count_nonzero(views < _MIN_VIEWS) > len(views))
