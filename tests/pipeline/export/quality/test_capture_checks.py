from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.association.identity.likenesses import Likenesses
from pipeline.core.data.cameras import Camera, CameraBump, CameraMove, Refinement, WorldMove
from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.own_points import OwnTracks, SceneObject
from pipeline.core.data.people import Doubt, Observations, PersonLoss
from pipeline.core.findings import Finding, SessionCheck, Severity
from pipeline.core.joints import COCO_17
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CAMERA_DISAGREES, CAMERA_SEES_NOBODY, NOBODY_DETECTED
from pipeline.export.quality.capture_checks import capture_checks
from pipeline.export.quality.report import all_checks, quality_report
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from tests.pipeline.export.quality.test_report import CAMERAS, camera, observe, reconstruction
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

TRACK = track_of(walker(40))


def unseen(observations: Observations, frames: slice, *cameras: int) -> Observations:
    points_px, score = observations.points_px.copy(), observations.score.copy()
    for index in cameras:
        points_px[frames, index], score[frames, index] = np.nan, 0.0
    return replace(observations, points_px=points_px, score=score)


def checks(observations: Observations, cameras: tuple[Camera, ...] = CAMERAS) -> list[tuple[str, str]]:
    report = quality_report(reconstruction(TRACK, observations=(observations,), cameras=cameras))
    assert [one.to_json() for one in all_checks(report)] == report["capture_checks"]
    return [(check["code"], check["message"]) for check in report["capture_checks"]]


def test_nothing_is_wrong_with_somebody_whom_three_cameras_see() -> None:
    assert checks(observe(TRACK)) == []


def test_empty_result_says_so() -> None:
    report = quality_report(reconstruction())
    assert [check.code for check in all_checks(report)] == ["nobody_found"]


def test_take_emptied_by_edits_is_not_found_empty() -> None:
    report = quality_report(replace(reconstruction(), is_emptied=True))
    assert [check.code for check in all_checks(report)] == ["everybody_removed"]


def nobody(check: SessionCheck) -> tuple[str, str, list[str]]:
    """Sentence and reason of an empty result, and the codes of all findings."""
    found = all_checks(quality_report(replace(reconstruction(), check=check)))
    return found[-1].message, found[-1].evidence["reason"], [one.code for one in found]


def test_empty_result_says_why() -> None:
    undetected = Finding(NOBODY_DETECTED, "Nobody was detected.", None, "error", "Look at the pictures.")
    message, reason, codes = nobody(SessionCheck((undetected,), {"a": 0, "b": 0}, 12))
    assert message == "No person was found. Nobody was detected. Look at the pictures."
    assert (reason, codes) == ("nobody_detected", ["nobody_detected", "nobody_found"])
    message, reason, codes = nobody(SessionCheck((), {"a": 24, "b": 12}, 12))
    assert "24 in a, 12 in b, at 12 instants" in message
    assert (reason, codes) == ("not_matched", ["nobody_found"])


def test_ball_does_not_hide_that_nobody_was_found() -> None:
    ball = OwnTracks(objects=(SceneObject("ball", ("ball",), TRACK),))
    unmatched = SessionCheck((), {"a": 24, "b": 12}, 12)
    undetected = SessionCheck((Finding(NOBODY_DETECTED, "Nobody was detected.", None, "error"),), {"a": 0, "b": 0}, 12)
    for check, codes in ((unmatched, ["nobody_found"]), (undetected, ["nobody_found"]), (SessionCheck(), [])):
        take = replace(reconstruction(), own=ball, check=check)
        assert [found["code"] for found in capture_checks(take, {}, Likenesses())] == codes


def test_two_cameras_are_few() -> None:
    two = CAMERAS[:2]
    ((code, message),) = checks(observe(TRACK, two), two)
    assert code == "too_few_cameras"
    assert "2 cameras" in message


def test_camera_that_was_matched_with_nobody_is_named() -> None:
    four = (*CAMERAS, camera("elsewhere", 4.0))
    ((code, message),) = checks(unseen(observe(TRACK, four), slice(None), 3), four)
    assert code == "camera_without_people"
    assert message.startswith("No person was matched in elsewhere: ")


def test_somebody_whom_two_cameras_see_in_most_frames_is_named() -> None:
    assert checks(unseen(observe(TRACK), slice(0, 20), 2)) == []
    ((code, message),) = checks(unseen(observe(TRACK), slice(0, 21), 2))
    assert code == "few_views"
    assert message.startswith(f"person-{TRACK.track_id} ")


def test_many_people_whom_two_cameras_see_are_one_check() -> None:
    doubtful = np.tile([True, True, False], (10, 1))
    seen = dict.fromkeys(range(1, 13), doubtful) | {20: np.ones((10, 3), bool)}
    (check,) = capture_checks(reconstruction(), seen, Likenesses())
    assert check == {
        "code": "few_views",
        "camera": None,
        "severity": "warning",
        "hint": None,
        "evidence": {},
        "message": "12 people were seen by fewer than 3 cameras in most frames: person-1, person-2, person-3, "
        "person-4, person-5, person-6, person-7, person-8, person-9, person-10 and 2 more.",
    }


def test_unmatched_cameras_many_make_one_check() -> None:
    others = tuple(camera(f"elsewhere-{k}", 4.0) for k in range(60))
    ((code, message),) = checks(
        unseen(observe(TRACK, (*CAMERAS, *others)), slice(None), *range(3, 63)), (*CAMERAS, *others)
    )
    assert code == "camera_without_people"
    assert message.startswith("No person was matched in 60 cameras: elsewhere-0, ")
    assert "elsewhere-9 and 50 more." in message


def test_frames_with_approximate_association_are_counted() -> None:
    crowded = replace(reconstruction(TRACK, observations=(observe(TRACK),)), num_approximate_frames=7)
    (check,) = all_checks(quality_report(crowded))
    assert check.code == "approximate_association"
    assert check.message.startswith("In 7 of 100 frames ")


def test_damaged_videos_are_named_with_what_is_damaged() -> None:
    one = DamagedVideo("left", "left.mp4", 3, 60, 0.8, 0.88)
    take = reconstruction(TRACK, observations=(observe(TRACK),), cameras=CAMERAS)
    (check,) = quality_report(replace(take, damaged=(one,)))["capture_checks"]
    assert check["code"] == "damaged_video"
    assert check["message"].startswith("A video is damaged: left.mp4 (3 of 60 frames, from 0.8 to 0.9 s).")
    (check,) = quality_report(replace(take, damaged=(one, replace(one, file="right.mp4"))))["capture_checks"]
    assert check["message"].startswith("2 videos are damaged: left.mp4 (3 of 60 frames, from 0.8 to 0.9 s), right.mp4 ")


def test_doubled_pictures_are_counted_with_their_times() -> None:
    take = reconstruction(TRACK, observations=(observe(TRACK),), cameras=CAMERAS)
    doubled_s = tuple(np.arange(8) / 4)
    one = DamagedVideo("left", "left.mp4", 0, 60, 0.0, 0.0, doubled_s)
    (check,) = quality_report(replace(take, damaged=(one,)))["capture_checks"]
    assert check["code"] == "frames_doubled"
    assert "in left.mp4 (8 of 60 frames, at 0.00, 0.25, 0.50, 0.75, 1.00 s and 3 more)." in check["message"]
    both = replace(one, num_damaged=2, first_s=0.1, last_s=0.4)
    checks = quality_report(replace(take, damaged=(both,)))["capture_checks"]
    assert [check["code"] for check in checks] == ["damaged_video", "frames_doubled"]


def test_only_people_whose_identity_is_uncertain_are_named() -> None:
    certain = replace(reconstruction(TRACK, observations=(observe(TRACK),)), doubts=[(Doubt(5, 0.95, 0),)])
    assert all_checks(quality_report(certain)) == []
    uncertain = replace(certain, doubts=[(Doubt(5, 0.95, 0), Doubt(20, 0.6, 2))])
    ((code, message),) = ((check.code, check.message) for check in all_checks(quality_report(uncertain)))
    assert code == "uncertain_identity"
    assert f"person-{TRACK.track_id} (frame 20)" in message


def test_moved_cameras_named_with_angles_and_times() -> None:
    one = replace(
        reconstruction(track_of(walker(40))),
        refinement=Refinement(
            True,
            7.25,
            3.5,
            4000,
            (CameraMove("c", 1.44, 0.02, 1.0, 21.4), CameraMove("a", 2.0, 0.01, 1.0, 8.0)),
            (CameraBump("b", 134.9, 0.9),),
            WorldMove(4.2, 0.3),
        ),
    )
    refined, levelled, bumped = quality_report(one)["capture_checks"]
    assert refined["code"] == "calibration_refined"
    assert "7.2 px" in refined["message"]
    assert "3.5 px" in refined["message"]
    assert "c by 21.4 px in its picture (1.4 degrees, 2.0 cm), a by 8.0 px" in refined["message"]
    assert levelled["code"] == "world_leveled"
    assert "tilted by 4.2 degrees and at a height of 0.30 m" in levelled["message"]
    assert quality_report(one)["calibration"]["world"] == {"tilt_deg": 4.2, "height_m": 0.3}
    assert bumped["code"] == "camera_bumped"
    assert "b from 02:14 on (0.9 degrees)" in bumped["message"]


def test_kept_calibration_says_why_and_names_camera() -> None:
    take = reconstruction(track_of(walker(40)))

    def kept(*refinement: Any, **more: Any) -> tuple[Finding, dict[str, Any]]:
        report = quality_report(replace(take, refinement=Refinement(False, *refinement, **more)))
        (finding,) = all_checks(report)
        assert (finding.code, finding.severity) == ("calibration_kept", "info")
        return finding, report["calibration"]

    few, document = kept(np.nan, np.nan, 12, refusal="few_people")
    assert "share 12 joints" in few.message
    assert (document["refined"], document["refusal"], document["most_moved"]) == (False, "few_people", None)
    no_better, document = kept(4.04, 3.52, 900, refusal="no_better", most_moved=CameraMove("b", 0.31, 0.004, 1.0, 5.2))
    assert "from 4.0 px to 3.5 px" in no_better.message
    assert "b would move most, by 5.2 px" in no_better.message
    assert document["moved"] == []
    assert document["most_moved"]["moved_px"] == 5.2
    undetermined, _ = kept(6.0, 6.0, 90, refusal="undetermined")
    assert "at 6.0 px, determine no camera" in undetermined.message


def test_lost_people_and_phantoms_are_findings() -> None:
    losses = (PersonLoss("vanished", 1, 12, 40, (0.52, -1.25, 1.0)), PersonLoss("phantom", 0, 3, 9, (2.0, 0.1, 0.9)))
    take = replace(reconstruction(TRACK, observations=(observe(TRACK),)), losses=losses)
    lost, phantom = all_checks(quality_report(take))
    assert (lost.code, lost.severity) == ("person_lost", "warning")
    assert "person-1 (frames 12 to 39, at x 0.5 m, y -1.2 m)" in lost.message
    assert lost.evidence["people"] == [
        {"person": 1, "start_frame": 12, "num_frames": 28, "place_m": [0.52, -1.25, 1.0]}
    ]
    assert phantom.code == "phantom_ended"
    assert "frames 3 to 8, at x 2.0 m, y 0.1 m" in phantom.message
    assert phantom.evidence["people"][0]["person"] is None


def test_limb_located_half_as_long_is_named() -> None:
    xyz_m = walker(40)
    elbow, wrist = COCO_17.indices(("left_elbow", "left_wrist"))
    xyz_m[:, wrist] = (xyz_m[:, wrist] + xyz_m[:, elbow]) / 2
    track = track_of(xyz_m)
    take = reconstruction(track, observations=(observe(track),))
    timebase = take.timebase
    motion = SkeletonFit(track, COCO_17, timebase, "person-1").motion()
    take = replace(take, animation=replace(take.animation, motions=(motion,)))
    (finding,) = (check for check in all_checks(quality_report(take)) if check.code == "limb_mismeasured")
    assert "left forearm of person-1 (125 mm, used are 250 mm)" in finding.message
    assert finding.evidence["limbs"] == [{"person": 1, "limb": "left forearm", "located_m": 0.125, "length_m": 0.25}]


def test_take_decides_which_cameras_disagree_little() -> None:
    def at_instants(camera: str, severity: Severity, code: Code = CAMERA_DISAGREES) -> dict[str, Any]:
        return Finding(code, "A few instants say so.", camera, severity).to_json()

    of_session = [
        at_instants("left", "warning"),
        at_instants("right", "error"),
        at_instants("left", "warning", CAMERA_SEES_NOBODY),
    ]
    report = {"people": [{"id": 1}], "session_checks": of_session, "capture_checks": [], "world_checks": []}
    assert [(check.code, check.camera) for check in all_checks(report)] == [
        ("camera_disagrees", "right"),
        ("camera_sees_nobody", "left"),
    ]
    assert len(all_checks(report | {"people": []})) == len(of_session)
