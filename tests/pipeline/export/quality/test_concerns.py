"""Places to look at: planted faults are found with their frames, and leave the list when they are accepted."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.core.data.people import Doubt
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.joints import COCO_17
from pipeline.core.options.edits import Accept
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CLOCKS_DISAGREE
from pipeline.export.quality.concerns import MAX_CONCERNS, Concern, find_concerns
from pipeline.export.quality.report import all_checks, quality_report
from pipeline.export.quality.views import person_views
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from tests.pipeline.export.quality.test_report import CAMERAS, camera, observe
from tests.pipeline.export.quality.test_report import reconstruction as make_reconstruction
from tests.pipeline.motion.skeleton.corrections.faults import FaultyTake, taken
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker


def reconstruction(take: FaultyTake) -> Reconstruction:
    animation = replace(take.animation, tracks=take.animation.tracks[:1], motions=take.animation.motions[:1])
    simulation = take.simulation
    return Reconstruction(
        simulation.cameras, simulation.joints, simulation.timebase, [take.located], [take.seen], animation
    )


def concerns_of(found: Reconstruction, kind: str) -> list[Concern]:
    return [concern for concern in find_concerns(found, person_views(found)) if concern.kind == kind]


def test_take_without_faults_gives_few_places() -> None:
    found = reconstruction(taken())
    assert not [concern for concern in find_concerns(found, person_views(found)) if concern.score > 0.5]


def test_exchanged_sides_are_found() -> None:
    take = taken().sides_exchanged(slice(70, 82))
    found = reconstruction(take)
    (concern,) = concerns_of(found, "sides")
    start = take.located.start_frame
    assert (concern.start_frame, concern.stop_frame) == (start + 70, start + 82)
    assert concern.message.startswith("Left and right ")
    assert find_concerns(found, person_views(found))[0].kind == "sides"


def test_lost_wrist_is_found() -> None:
    take = taken().seen_elsewhere("right_wrist", slice(80, 95), np.zeros(3), [])
    places = {concern.joint: concern for concern in concerns_of(reconstruction(take), "few_views")}
    concern = places["right_wrist"]
    assert (concern.start_frame, concern.stop_frame) == (take.located.start_frame + 80, take.located.start_frame + 95)
    assert concern.message == "Fewer than two cameras see the right wrist for 0.6 s."


def test_joint_far_from_its_detections_is_found() -> None:
    take = taken()
    points_px = np.array(take.seen.points_px)
    points_px[50:60, :, take.index("left_knee"), 0] += 60.0
    found = replace(reconstruction(take), observations=[replace(take.seen, points_px=points_px)])
    (concern,) = concerns_of(found, "error")
    assert concern.joint == "left_knee"
    assert (concern.start_frame, concern.stop_frame) == (take.located.start_frame + 50, take.located.start_frame + 60)


def test_sudden_acceleration_is_found() -> None:
    take = taken()
    track = take.animation.tracks[0]
    xyz_m = np.array(track.xyz_m)
    xyz_m[60, take.index("left_elbow")] += 0.3
    found = reconstruction(take)
    found = replace(found, animation=replace(found.animation, tracks=(replace(track, xyz_m=xyz_m),)))
    assert concerns_of(found, "acceleration")[0].joint == "left_elbow"


@pytest.mark.parametrize("kind", ["identity", "sides"])
def test_accepted_place_leaves_list(kind: str) -> None:
    take = taken().sides_exchanged(slice(70, 82))
    start = take.located.start_frame
    found = replace(reconstruction(take), doubts=[[Doubt(start + 75, 0.6, 2)]])
    accept = Accept(person=1, kind="sides", start_frame=start + 70, stop_frame=start + 82)
    number = take.located.track_id
    found = replace(found, accepted={number: (replace(accept, kind=kind),)})  # type: ignore[arg-type]
    assert not concerns_of(found, kind)
    assert concerns_of(found, "sides" if kind == "identity" else "identity")


def test_list_is_bounded() -> None:
    take = taken()
    found = reconstruction(take)
    doubts = [[Doubt(frame, 0.5, 2) for frame in range(take.located.start_frame, take.located.start_frame + 120)]]
    assert len(find_concerns(replace(found, doubts=doubts), person_views(found))) == MAX_CONCERNS


def accepted_one_by_one(take: Reconstruction) -> list[list[Code]]:
    """Codes of the take's warnings, at first and after each look at its worst place, which is accepted."""
    warnings = []
    while True:
        report = quality_report(take)
        warnings.append([finding.code for finding in all_checks(report)])
        if not report["concerns"]:
            return warnings
        worst = report["concerns"][0]
        edit = Accept(**{name: worst[name] for name in ("camera", "kind", "start_frame", "stop_frame")})
        number = worst["person"] or 0
        take = replace(take, accepted={**take.accepted, number: (*take.accepted.get(number, ()), edit)})


def test_accepted_findings_leave_warnings() -> None:
    """A camera that disagrees, one without people, a long limb, small people: a look each."""
    step = np.array([np.radians(2.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    cameras = (CAMERAS[0], move_camera(CAMERAS[1], step), CAMERAS[2], camera("elsewhere", 4.0))
    xyz_m = walker(100) * 0.5
    track = track_of(xyz_m)
    seen = observe(track, (*CAMERAS, cameras[3]))
    points_px, score = np.array(seen.points_px), np.array(seen.score)
    points_px += np.random.default_rng(3).normal(0.0, 1.0, points_px.shape)
    points_px[:, 3], score[:, 3] = np.nan, 0.0
    take = make_reconstruction(track, observations=(replace(seen, points_px=points_px, score=score),), cameras=cameras)
    elbow, wrist = COCO_17.indices(("left_elbow", "left_wrist"))
    xyz_m[:, wrist] = (xyz_m[:, wrist] + xyz_m[:, elbow]) / 2
    motion = SkeletonFit(track, COCO_17, take.timebase, "person-1").motion()
    take = replace(take, located=(track_of(xyz_m),), animation=replace(take.animation, motions=(motion,)))
    clocks = Finding(CLOCKS_DISAGREE, "The clock is late.", "a")
    warnings = accepted_one_by_one(replace(take, check=SessionCheck((clocks,))))
    assert {"clocks_disagree", "camera_without_people", "limb_mismeasured", "stature_out_of_range"} < {*warnings[0]}
    assert "camera_disagrees" in warnings[0]
    assert [len(codes) for codes in warnings] == list(range(len(warnings[0]), -1, -1))


def test_accepted_still_person_leaves_warnings() -> None:
    still = track_of(np.repeat(walker(1), 100, axis=0))
    take = make_reconstruction(still, observations=(observe(still),))
    assert accepted_one_by_one(take) == [["person_never_moves"], []]
