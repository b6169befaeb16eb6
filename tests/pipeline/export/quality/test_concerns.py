"""Places to look at: planted faults are found with their frames, and leave the list when they are accepted."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.people import Doubt
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.edits import Accept
from pipeline.export.quality.concerns import MAX_CONCERNS, Concern, find_concerns
from pipeline.export.quality.views import person_views
from tests.pipeline.motion.skeleton.corrections.faults import FaultyTake, taken


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
