"""Quality of a reconstruction without ground truth: the contents of ``metrics.json``.

- *Reprojection error*: distance between each matched 2D observation with a score of at least 0.2, inlier or not, and
  the projection of the joint's final position, in distorted pixels of the full image.
- *Coverage*: share of a track's joints that were measured, over all frames from the first to the last.
- *Views a joint*: matched observations of each joint with a position. *Joints a frame*: joints with a position. Both
  are reported because dropping views or joints would lower the reprojection error.
- *Bone length deviation*: standard deviation over time of a limb's length in one track, mean over limbs and tracks,
  weighted by frames.
- *Jitter*: mean length of the second difference of a joint's position times the squared frame rate.
- *Before*: the same figure for the joints located by association, before smoothing or the skeleton fit.
- *Sources*: shares of joints that were measured, interpolated or predicted, or that are absent, over all frames.
- *Cameras used*: share of all people's frames in which a camera saw any of their joints.
- *Track fragments*: tracks that begin within 2 s and 1.5 m of the end of another track. The person was probably lost.
- *Slide*: mean horizontal distance of a standing foot's ankle, heel or toe from its median position over all contacts,
  before and after feet were held in place.
- *Hands*: share of a person's frames in which at least half of the joints of a hand's fingers were measured, and the
  median reprojection error of these joints. Joint sets without fingers have no such block. All other figures, except
  the errors by joint, leave fingers out: cameras that are too far for fingers say nothing about the body.
- *Angles*: range of each joint angle and its usual standard deviation; see ``pipeline.motion.angles``.
- *Identity*: probability that a person is one and the same all the time, the product over the moments at which another
  choice was nearly as likely (``doubts``, with a confidence below 0.99 each); see ``pipeline.association.identity``.
- *Concerns*: places to look at, worst first; see ``export.quality.concerns``.
- *Gait*, *movements*: see ``pipeline.motion.gait``; ``gait`` is null without gait.
- *Stature*: from the medians of shin, thigh and trunk, which are 0.779 of the stature (Drillis and Contini 1966).

A figure without data is null (``None``).
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.association.identity.likenesses import find_likenesses
from pipeline.association.own_points.rigid import rigid_motions
from pipeline.capture.synchronization.report import sync_document
from pipeline.core.data.animation import Floor, FootContact
from pipeline.core.data.cameras import Camera, CameraMove, Refinement
from pipeline.core.data.own_points import OwnTracks
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import CERTAIN, Finding
from pipeline.core.joints import LIMBS, SIDES, JointSet, finger_joints
from pipeline.core.problems.finding_codes import CAMERA_DISAGREES, OWN_POINTS_DOUBTFUL
from pipeline.core.runtime import large_arrays
from pipeline.export.quality.camera_shifts import CameraShift, find_shifted
from pipeline.export.quality.capture_checks import capture_checks
from pipeline.export.quality.concerns import find_concerns
from pipeline.export.quality.laboratory_report import laboratory_checks, laboratory_document
from pipeline.export.quality.views import PersonViews, body_joints, has_position, person_views, without_fingers
from pipeline.export.quality.world_checks import world_checks
from pipeline.motion.angles.compute import joint_angles, ranges_of_motion
from pipeline.motion.balance.compute import balance_document, balance_of
from pipeline.motion.gait.analysis import analyse_gait, gait_document, movement_documents
from pipeline.motion.skeleton.fitting.positions import MAX_GAP_S

SCHEMA_VERSION = 1
_FRAGMENT_S, _FRAGMENT_M = 2.0, 1.5
# Share of the joints of its fingers that make a hand measured.
_HAND_SHARE = 0.5
# Bodies by which cameras are compared, about the largest number.
_MAX_SAMPLED = 400
_SHIN_THIGH_TRUNK_SHARE = 0.246 + 0.245 + 0.288


def quality_report(reconstruction: Reconstruction, views: Sequence[PersonViews] | None = None) -> dict[str, Any]:
    """Compute the content of ``metrics.json`` as plain Python values, rounded.

    ``capture_checks`` and ``world_checks`` list the findings of failed checks. ``forced``, of
    a session that was reconstructed in spite of errors alone, lists their codes. ``views`` are the ``person_views`` of
    the reconstruction, if they are known.
    """
    views = person_views(reconstruction) if views is None else views
    joints, cameras = reconstruction.joints, reconstruction.cameras
    frame_rate_hz = reconstruction.timebase.frame_rate_hz
    tracks = [without_fingers(track, joints) for track in reconstruction.tracks]
    located = [of_person.located for of_person in views]
    errors_px = [figures.error_px for figures in views]
    contacts = {motion.track_id: motion.contacts for motion in reconstruction.motions}
    whole_tracks = {track.track_id: track for track in reconstruction.tracks}
    ranges = {
        motion.track_id: ranges_of_motion(joint_angles(motion, whole_tracks[motion.track_id], joints))
        for motion in reconstruction.motions
    }
    balances = {
        motion.track_id: balance_document(
            balance_of(motion, whole_tracks[motion.track_id], joints, reconstruction.subject_of(motion.track_id))
        )
        for motion in reconstruction.motions
    }
    statures_m = {track.track_id: estimate_stature_m(track, joints) for track in tracks}
    gaits = {track.track_id: analyse_gait(track, joints, frame_rate_hz) for track in tracks}
    all_doubts = reconstruction.doubts or [()] * len(tracks)
    seen = {track.track_id: figures.sees for track, figures in zip(tracks, views, strict=True)}
    likenesses = find_likenesses(
        reconstruction.located, lambda number: views[number].sees, cameras, joints, frame_rate_hz
    )
    report = {
        "schema_version": SCHEMA_VERSION,
        "num_frames": reconstruction.timebase.num_frames,
        "frame_rate_hz": frame_rate_hz,
        "reprojection_error_px": _summarise_error(errors_px, cameras, joints),
        "coverage": _rounded(np.mean(_known(track.source == Source.MEASURED for track in tracks)), 4),
        "sources": {
            source.name.lower(): _rounded(np.mean(_known(track.source == source for track in tracks)), 4)
            for source in Source
        },
        "max_gap_s": MAX_GAP_S,
        "bone_length_std_cm": _rounded(bone_length_std_cm(tracks, joints), 3),
        "bone_length_std_before_cm": _rounded(bone_length_std_cm(located, joints), 3),
        "jitter_m_s2": _rounded(mean_jitter_m_s2(tracks, frame_rate_hz), 3),
        "jitter_before_m_s2": _rounded(mean_jitter_m_s2(located, frame_rate_hz), 3),
        "cameras_used": {
            camera.name: _rounded(float(np.mean(_known(sees[:, index] for sees in seen.values()))), 4)
            for index, camera in enumerate(reconstruction.cameras)
        },
        "track_fragments": sum(
            any(_continues(earlier, later, frame_rate_hz) for earlier in tracks if earlier is not later)
            for later in tracks
        ),
        "floor": _describe_floor(reconstruction.animation.floor),
        "feet": _summarise_feet([contact for motion in reconstruction.motions for contact in motion.contacts]),
        "people": [
            {
                "id": track.track_id,
                "start_frame": track.start_frame,
                "num_frames": track.num_frames,
                "coverage": _rounded(np.mean(track.source == Source.MEASURED), 4),
                "stature_m": _rounded(statures_m[track.track_id], 3),
                "reprojection_error_px": _rounded(np.median(_known([figures.error_px[:, :, body_joints(joints)]])), 3),
                "views_per_joint": _rounded(figures.views_per_joint, 2),
                "joints_per_frame": _rounded(has_position(track).sum(-1).mean(), 2),
                "feet": {
                    "toes": "measured" if _sees_toes(track, joints) else "predicted",
                    **_summarise_feet(contacts.get(track.track_id, ())),
                    "contacts": [_describe_contact(contact) for contact in contacts.get(track.track_id, ())],
                },
                "gait": gait_document(gaits[track.track_id]),
                "movements": movement_documents(gaits[track.track_id], reconstruction.timebase),
                "angles": ranges.get(track.track_id, {}),
                "balance": balances.get(track.track_id),
                **_describe_hands(whole, figures.error_px, joints),
                "identity": {
                    "confidence": round(math.prod(doubt.confidence for doubt in doubts), 4),
                    "doubts": [
                        {"frame": doubt.frame, "confidence": round(doubt.confidence, 4), "other": doubt.other or None}
                        for doubt in doubts
                    ],
                },
            }
            for whole, track, figures, doubts in zip(reconstruction.tracks, tracks, views, all_doubts, strict=True)
        ],
        "calibration": _describe_refinement(reconstruction.refinement),
        "sync": None if reconstruction.synchronization is None else sync_document(reconstruction.synchronization),
        "provider": reconstruction.provider,
        "layout": reconstruction.layout,
        "concerns": [],
        "session_checks": [
            finding.to_json()
            for finding in reconstruction.check.findings
            if not reconstruction.accepts(finding.code, camera=finding.camera)
        ],
        **({"forced": list(reconstruction.check.forced)} if reconstruction.check.forced else {}),
        **laboratory_document(reconstruction.laboratory),
        **({"rigid_objects": rigid} if (rigid := _describe_rigid(reconstruction.own)) else {}),
        "capture_checks": [
            *capture_checks(reconstruction, seen, likenesses),
            *laboratory_checks(reconstruction.laboratory),
            *(Finding(OWN_POINTS_DOUBTFUL, doubt).to_json() for doubt in reconstruction.own.doubts),
        ],
        "world_checks": world_checks(reconstruction, statures_m, _shifted(reconstruction.cameras, views)),
    }
    concerns = find_concerns(reconstruction, views, all_checks(report))
    return report | {"concerns": [concern._asdict() for concern in concerns]}


def _describe_rigid(own: OwnTracks) -> list[dict[str, Any]]:
    return [
        {
            "name": motion.shape.name,
            "person": motion.person,
            "coverage": _rounded(np.mean(motion.num_points > 0), 4),
            "rms_mm": _rounded(1000.0 * np.nanmedian(motion.rms_m), 2),
        }
        for motion in rigid_motions(own)
    ]


def _shifted(cameras: Sequence[Camera], views: Sequence[PersonViews]) -> Sequence[CameraShift]:
    """Cameras that see the people of the take elsewhere than the others do."""
    if not views:
        return []
    instant = np.concatenate([of_person.instant for of_person in views])
    points_px = np.concatenate([of_person.sampled_px for of_person in views])
    instants = np.unique(instant)
    kept = np.isin(instant, instants[:: -(-len(instant) // _MAX_SAMPLED)])
    return find_shifted(cameras, points_px[kept], instant[kept])


def _describe_refinement(refinement: Refinement | None) -> dict[str, Any] | None:
    if refinement is None:
        return None
    return {
        "refined": refinement.refined,
        "error_before_px": _rounded(refinement.error_before_px, 3),
        "error_after_px": _rounded(refinement.error_after_px, 3),
        "num_points": refinement.num_points,
        "refusal": refinement.refusal,
        "moved": [_describe_move(move) for move in refinement.moved],
        "most_moved": None if refinement.most_moved is None else _describe_move(refinement.most_moved),
        "bumped": [
            {"camera": bump.camera, "time_s": round(bump.time_s, 3), "rotation_deg": round(bump.rotation_deg, 2)}
            for bump in refinement.bumped
        ],
        "world": None
        if refinement.world is None
        else {"tilt_deg": round(refinement.world.tilt_deg, 3), "height_m": round(refinement.world.height_m, 4)},
    }


def _describe_move(move: CameraMove) -> dict[str, Any]:
    return {
        "camera": move.camera,
        "rotation_deg": round(move.rotation_deg, 3),
        "translation_m": round(move.translation_m, 4),
        "focal_ratio": round(move.focal_ratio, 4),
        "moved_px": _rounded(move.moved_px, 1),
    }


def all_checks(report: Mapping[str, Any]) -> list[Finding]:
    """Findings of all failed checks of a report: of the session at a few instants, of the capture, of the world."""
    of_take = [Finding.from_json(check) for check in (*report["capture_checks"], *report["world_checks"])]
    known = {(finding.code, finding.camera) for finding in of_take}
    of_session = [Finding.from_json(finding) for finding in report.get("session_checks", ())]
    # The whole take is more exact than a few instants: of cameras that disagree a little there,
    # it names those that do.
    return [
        *(
            finding
            for finding in of_session
            if (finding.code, finding.camera) not in known
            and not (finding.code == CAMERA_DISAGREES and finding.severity == "warning" and report["people"])
        ),
        *of_take,
    ]


def encode(report: dict[str, Any]) -> bytes:
    """Encode a report as strict JSON; equal reports give equal bytes."""
    return (json.dumps(report, allow_nan=False, indent=2) + "\n").encode("ascii")


def _known(arrays: Iterable[np.ndarray]) -> np.ndarray:
    """Concatenate all values that are not NaN; a single NaN if there are none, so that mean and median are NaN."""
    arrays = list(arrays)
    counts = [int(np.count_nonzero(np.isfinite(array))) for array in arrays]
    flat, stop = large_arrays.empty((sum(counts),), np.result_type(np.float32, *{array.dtype for array in arrays})), 0
    for array, count in zip(arrays, counts, strict=True):
        flat[stop : stop + count] = array[np.isfinite(array)]
        stop += count
    return flat if len(flat) else np.array([np.nan])


def _rounded(value: float | np.floating, decimals: int) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None


def _summarise_error(
    errors_px: list[Float[np.ndarray, "_ cameras joints"]], cameras: tuple[Camera, ...], joints: JointSet
) -> dict[str, Any]:
    def median_and_p95(arrays: Iterable[np.ndarray]) -> list[float | None]:
        return [_rounded(value, 3) for value in np.percentile(_known(arrays), (50.0, 95.0), overwrite_input=True)]

    body_px = [error_px[:, :, body_joints(joints)] for error_px in errors_px]
    overall = median_and_p95(body_px)
    by_camera = {
        camera.name: median_and_p95(error_px[:, index] for error_px in body_px) for index, camera in enumerate(cameras)
    }
    by_joint = {
        name: median_and_p95(error_px[:, :, index] for error_px in errors_px) for index, name in enumerate(joints.names)
    }
    return {
        "median": overall[0],
        "p95": overall[1],
        "by_camera": {name: figures[0] for name, figures in by_camera.items()},
        "p95_by_camera": {name: figures[1] for name, figures in by_camera.items()},
        "by_joint": {name: figures[0] for name, figures in by_joint.items()},
        "p95_by_joint": {name: figures[1] for name, figures in by_joint.items()},
        "num_observations": sum(int(np.isfinite(error_px).sum()) for error_px in body_px),
    }


def _continues(earlier: Track3D, later: Track3D, frame_rate_hz: float) -> bool:
    pause = later.start_frame - (earlier.start_frame + earlier.num_frames)
    if not 0 <= pause <= _FRAGMENT_S * frame_rate_hz:
        return False
    end_m, start_m = _known_joints_m(earlier.xyz_m[::-1]), _known_joints_m(later.xyz_m)
    return bool(np.linalg.norm(end_m - start_m) <= _FRAGMENT_M)


def _known_joints_m(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, " 3"]:
    """Centre of the joints in the first frame with a known joint; NaN if there is no such frame."""
    known = np.isfinite(xyz_m).all(-1)
    frames = np.flatnonzero(known.any(1))
    return xyz_m[frames[0]][known[frames[0]]].mean(0) if len(frames) else np.full(3, np.nan)


def _describe_floor(floor: Floor | None) -> dict[str, float | None] | None:
    if floor is None:
        return None
    return {"height_m": _rounded(floor.z_m, 3), "tilt_deg": _rounded(floor.tilt_deg, 2)}


def _summarise_feet(contacts: Sequence[FootContact]) -> dict[str, Any]:
    frames = np.array([contact.num_frames for contact in contacts])

    def mean_cm(slides_m: list[float]) -> float | None:
        return _rounded(100 * np.average(slides_m, weights=frames), 2) if contacts else None

    return {
        "num_contacts": len(contacts),
        "num_pinned": sum(contact.pinned for contact in contacts),
        "slide_before_cm": mean_cm([contact.slide_before_m for contact in contacts]),
        "slide_after_cm": mean_cm([contact.slide_after_m for contact in contacts]),
    }


def _describe_contact(contact: FootContact) -> dict[str, Any]:
    return {
        "foot": contact.side,
        "start_frame": contact.start_frame,
        "num_frames": contact.num_frames,
        "confidence": _rounded(contact.confidence, 3),
        "pinned": contact.pinned,
        **({} if contact.part == "foot" else {"part": contact.part}),
    }


def _describe_hands(
    track: Track3D, error_px: Float[np.ndarray, "frames cameras joints"], joints: JointSet
) -> dict[str, Any]:
    """Figures of both hands of a person; empty for a joint set without fingers."""
    hands = {}
    for side in SIDES:
        fingers = [number for number, name in enumerate(joints.names) if name in finger_joints(side)]
        if fingers:
            measured = (track.source[:, fingers] == Source.MEASURED).mean(1) >= _HAND_SHARE
            hands[side] = {
                "measured": _rounded(measured.mean(), 4),
                "reprojection_error_px": _rounded(np.median(_known([error_px[:, :, fingers]])), 3),
            }
    return {"hands": hands} if hands else {}


def _sees_toes(track: Track3D, joints: JointSet) -> bool:
    toes = [index for index, name in enumerate(joints.names) if name.endswith("_toe")]
    return bool((track.source[:, toes] == Source.MEASURED).any())


def mean_jitter_m_s2(tracks: Sequence[Track3D], frame_rate_hz: float) -> float:
    """Mean length of the joints' second differences times the squared frame rate; NaN without any."""
    return float(np.mean(_known(acceleration_m_s2(track, frame_rate_hz) for track in tracks)))


def bone_length_std_cm(tracks: Sequence[Track3D], joints: JointSet) -> float:
    """Standard deviation of a limb's length in a track, mean over limbs and tracks weighted by frames, in cm.

    NaN if no limb is known in two frames of a track.
    """
    num_frames, weighted_cm = 0, 0.0
    for track in tracks:
        for start, end in LIMBS:
            if start not in joints.names or end not in joints.names:
                continue
            bones_m = track.xyz_m[:, joints.index(end)] - track.xyz_m[:, joints.index(start)]
            lengths_cm = _known([100.0 * np.linalg.norm(bones_m, axis=-1)])
            if len(lengths_cm) > 1:
                num_frames += len(lengths_cm)
                weighted_cm += len(lengths_cm) * float(np.std(lengths_cm))
    return weighted_cm / num_frames if num_frames else np.nan


def acceleration_m_s2(track: Track3D, frame_rate_hz: float) -> Float[np.ndarray, "triples joints"]:
    """Length of each joint's second difference over time; NaN where one of the three frames has no position.

    The array is empty for tracks of fewer than three frames.
    """
    return np.linalg.norm(np.diff(track.xyz_m, n=2, axis=0), axis=-1) * frame_rate_hz**2


def estimate_stature_m(track: Track3D, joints: JointSet) -> float:
    """Estimate a person's stature in metres; NaN if shin, thigh or trunk is known in no frame."""
    kinds = ("shoulder", "hip", "knee", "ankle")
    if not {f"{side}_{kind}" for side in ("left", "right") for kind in kinds} <= set(joints.names):
        return np.nan
    left, right = (
        {kind: track.xyz_m[:, joints.index(f"{side}_{kind}")] for kind in kinds} for side in ("left", "right")
    )
    trunk_m = (left["shoulder"] + right["shoulder"] - left["hip"] - right["hip"]) / 2
    segments = (
        [left["ankle"] - left["knee"], right["ankle"] - right["knee"]],
        [left["knee"] - left["hip"], right["knee"] - right["hip"]],
        [trunk_m],
    )
    lengths_m = [np.median(_known(np.linalg.norm(bone_m, axis=-1) for bone_m in bones_m)) for bones_m in segments]
    return float(sum(lengths_m)) / _SHIN_THIGH_TRUNK_SHARE


# Checks of the capture that tell of the calibration; others are about the take.
_NOBODY = "nobody_found"
_OF_CAPTURE = frozenset({_NOBODY, "camera_without_people"})
# Checks that people decide better than the cameras alone.
_BY_PEOPLE = frozenset({"upside_down", "not_upright", "camera_below_floor"})
# Findings with which people are located nowhere, or wrongly.
_UNDECIDED = frozenset({_NOBODY, "nobody_detected", "same_video", "calibration_of_another_rig"})


def people_findings(report: Mapping[str, Any]) -> list[Finding]:
    """Failed checks of a take that tell of its calibration.

    ``report`` comes from ``pipeline.export.quality.report.quality_report``.
    """
    of_world = {finding["code"] for finding in report["world_checks"]}
    return [finding for finding in all_checks(report) if finding.code in _OF_CAPTURE | of_world]


def join_findings(alone: Sequence[Finding], of_people: Sequence[Finding]) -> list[Finding]:
    """Join findings about cameras alone with findings about people, who decide what is up and where the floor is.

    What is wrong with cameras is seen by the people: errors of the cameras alone become warnings, but for those with
    which no person could be located.
    """
    if not any(finding.code in _UNDECIDED for finding in of_people):
        alone = [finding for finding in alone if finding.code not in _BY_PEOPLE]
    return [*(finding if finding.code in CERTAIN else _outweighed(finding) for finding in alone), *of_people]


def _outweighed(finding: Finding) -> Finding:
    return replace(finding, severity="warning") if finding.severity == "error" else finding
