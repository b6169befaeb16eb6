"""Laws of plans: ranges, keys and reuse of stages."""

import tracemalloc
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase, Recording
from pipeline.core.options.config import MAX_OUTPUT_FRAMES, NETWORKS, ReconstructionConfig, method_warnings
from pipeline.core.options.job_choices import CalibrationChoices, ProxyChoices, VisualChoices
from pipeline.detection.entries import REGISTRY
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.plan import MAX_TASKS, STAGES, effective_choices, plan
from pipeline.run.engine.stage import (
    ASSOCIATE,
    BLUR,
    CHECK,
    DETECT,
    EXPECT,
    EXPORT,
    FIT,
    HEADS,
    HOLD,
    IDENTIFY,
    LENGTHS,
    LOOK,
    OVERLAY,
    POSES,
    PROXY,
    RECORD,
    REDETECT,
    REFINE,
    REPORT,
    FrameCut,
)
from pipeline.run.steps.detect import LOOKED_AT_FRAMES
from worker.run.planning import plan_job, session_facts
from worker.store.model.session_records import InputFile, Session
from worker.store.model.work import StagePlan
from worker.store.spec import JobSpec

FILES = tuple(
    InputFile(name, kind, f"sessions/s/inputs/{k}-{name}", 10, digit * 64)
    for k, (name, kind, digit) in enumerate(
        [("left.mp4", "video", "a"), ("right.mp4", "video", "b"), ("rig.toml", "calibration", "c")]
    )
)


def make_session(num_frames: int = 100, rates_hz: tuple[float, ...] = (25.0, 25.0), **changes: Any) -> Session:
    """Session of as many output frames, at the rate of the fastest camera."""
    preflight = Preflight(
        cameras=tuple(
            PreflightCamera(str(k), f"{k}.mp4", (640, 480), rate_hz, num_frames) for k, rate_hz in enumerate(rates_hz)
        ),
        timebase=PreflightTimebase(0.0, max(rates_hz), num_frames),
        stretches=(range(num_frames),),
    )
    return Session(
        **{
            "id": "s",
            "name": "take",
            "created_at": datetime.now(UTC),
            "files": FILES,
            "preflight": preflight,
            **changes,
        }
    )


def keys(
    session: Session, spec: JobSpec | None = None, chunk_frames: int = 25, codes: Mapping[str, str] | None = None
) -> dict[str, list[str]]:
    return {
        stage.name: [chunk.output_key for chunk in stage.chunks]
        for stage in plan_job(replace(session, chunk_frames=chunk_frames), spec or JobSpec(), codes)
    }


@given(num_frames=st.integers(1, 2000), chunk_frames=st.integers(1, 300))
def test_chunks_cover_each_frame_of_each_camera_once_on_grid(num_frames: int, chunk_frames: int) -> None:
    chunks = list(plan_job(make_session(num_frames, chunk_frames=chunk_frames), JobSpec())[1].chunks)
    assert [chunk.index for chunk in chunks] == list(range(len(chunks)))
    for camera in ("0", "1"):
        of_camera = [chunk for chunk in chunks if chunk.payload["camera"] == camera]
        frames = [k for chunk in of_camera for k in range(chunk.payload["start_frame"], chunk.payload["stop_frame"])]
        assert frames == list(range(num_frames))
        assert all(chunk.payload["start_frame"] == k * chunk_frames for k, chunk in enumerate(of_camera))
    assert all(chunk.unit_count >= 1 for chunk in chunks)


def test_stages_and_their_sizes() -> None:
    stages = plan_job(make_session(60, chunk_frames=25), JobSpec())
    assert [(stage.name, len(list(stage.chunks))) for stage in stages] == [
        (LOOK, 2),
        (DETECT, 6),
        (CHECK, 1),
        (ASSOCIATE, 1),
        (EXPECT, 1),
        (REDETECT, 6),
        (IDENTIFY, 1),
        (FIT, 2),
        (HOLD, 2),
        (EXPORT, 1),
    ]
    assert [chunk.unit_count for chunk in stages[0].chunks] == [LOOKED_AT_FRAMES] * 2
    assert [chunk.unit_count for chunk in stages[1].chunks] == [25, 25, 25, 25, 10, 10]
    assert [chunk.unit_count for chunk in stages[5].chunks] == [2, 2, 2, 2, 1, 1]  # people lean in few frames


@pytest.mark.parametrize(("num_frames", "num_parts"), [(20, 1), (49, 1), (50, 2), (100, 4), (90_000, 4)])
def test_long_takes_are_fitted_in_parts(num_frames: int, num_parts: int) -> None:
    stages = plan_job(make_session(num_frames, chunk_frames=250), JobSpec())
    sizes = {stage.name: len(list(stage.chunks)) for stage in stages}
    assert (sizes[FIT], sizes[HOLD], sizes[IDENTIFY]) == (num_parts, num_parts, 1)


def test_following_does_not_count_for_fields() -> None:
    session = make_session()
    assert keys(session, CLUSTERING.model_copy(update={"follow_s": 0.1})) == keys(session, CLUSTERING)


def test_cutoff_counts_where_it_is_used() -> None:
    session = make_session()
    assert keys(session, JobSpec(cutoff_hz=3.0)) == keys(session)
    low, high = (keys(session, JobSpec(smoothing="butterworth", cutoff_hz=hz)) for hz in (3.0, 6.0))
    assert {name for name in low if low[name] != high[name]} == {FIT, HOLD, EXPORT}


FROM_PLACES = {EXPECT, REDETECT, IDENTIFY, FIT, HOLD, EXPORT}
VIDEO_STAGES = (*(LOOK, DETECT, CHECK, ASSOCIATE, EXPECT, REDETECT, IDENTIFY, FIT, HOLD, EXPORT),)
CLUSTERING = JobSpec(method="clustering", detector="openpose-mobilenet-thin")


def test_clustering_finds_people_in_ranges_of_detection() -> None:
    _, detect, _, lengths, poses, *_ = stages = plan_job(make_session(60, chunk_frames=25), CLUSTERING)
    assert [stage.name for stage in stages] == [
        *(LOOK, DETECT, CHECK, LENGTHS, POSES, ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT),
    ]
    assert next(iter(lengths.chunks)).payload["chunk_frames"] == 25
    ranges = [(chunk.payload["start_frame"], chunk.payload["stop_frame"]) for chunk in poses.chunks]
    assert ranges == [(0, 25), (25, 50), (50, 60)]
    assert [chunk.unit_count for chunk in poses.chunks] == [25, 25, 10]
    of_ranges = [(chunk.payload["start_frame"], chunk.payload["stop_frame"]) for chunk in detect.chunks]
    assert of_ranges == [one for one in ranges for _ in range(2)]  # cameras


def test_refinement_is_stage_before_association_and_is_reused() -> None:
    session = make_session(60)
    refined = keys(session, JobSpec(refine_calibration="auto"))
    assert list(refined) == [*VIDEO_STAGES[:3], REFINE, *VIDEO_STAGES[3:]]
    assert len(refined[REFINE]) == 1
    smoothed = keys(session, JobSpec(refine_calibration="auto", smoothing="none", appearance="off"))
    assert smoothed[REFINE] == refined[REFINE]
    other_frames = keys(session, JobSpec(refine_calibration="auto", frame_range=(0, 30)))
    assert other_frames[REFINE] != refined[REFINE]


def test_fields_are_another_output_than_bodies() -> None:
    session = make_session()
    bodies = keys(session, JobSpec(detector=CLUSTERING.detector))
    assert not set(bodies[DETECT]) & set(keys(session, CLUSTERING)[DETECT])
    # Both methods use the same whole bodies.
    assert keys(session)[DETECT] == keys(session, JobSpec(method="clustering"))[DETECT]


def test_cameras_to_be_calibrated_are_compared_without_poses() -> None:
    given, calibrated, drawn = (
        [chunk.output_key for chunk in plan_job(make_session(), JobSpec(), making=making)[0].chunks]
        for making in (None, CalibrationChoices(None), VisualChoices())
    )
    assert given == drawn
    assert not set(given) & set(calibrated)


@given(chunk_frames=st.integers(1, 300))
def test_keys_of_clusterings_reduces_do_not_depend_on_cut(chunk_frames: int) -> None:
    one, other = keys(make_session(), CLUSTERING, chunk_frames), keys(make_session(), CLUSTERING)
    assert all(one[name] == other[name] for name in (LENGTHS, ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT))


def test_units_are_frames_of_each_camera_at_its_own_rate() -> None:
    chunks = plan_job(make_session(50, rates_hz=(50.0, 25.0, 30.0), chunk_frames=50), JobSpec())[1].chunks
    assert [chunk.unit_count for chunk in chunks] == [50, 25, 30]


@given(chunk_frames=st.integers(1, 300))
def test_keys_of_reduces_do_not_depend_on_cut(chunk_frames: int) -> None:
    one, other = keys(make_session(), chunk_frames=chunk_frames), keys(make_session())
    assert {name: one[name] for name in (ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT)} == {
        name: other[name] for name in (ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT)
    }


def test_equal_work_has_equal_keys_whatever_it_is_called() -> None:
    again = make_session(id="t", name="other", created_at=datetime(2020, 1, 1, tzinfo=UTC), files=FILES[::-1])
    assert keys(again) == keys(make_session())


@pytest.mark.parametrize("changed", [replace(FILES[0], sha256="d" * 64), replace(FILES[0], name="centre.mp4")])
def test_another_input_changes_all_keys(changed: InputFile) -> None:
    other = keys(make_session(files=(changed, *FILES[1:])))
    ours = keys(make_session())
    assert not {key for found in other.values() for key in found} & {key for found in ours.values() for key in found}


@pytest.mark.parametrize(
    ("choice", "changed"),
    [
        ({"detector": "openpose-mobilenet-thin"}, set(VIDEO_STAGES)),
        ({"follow_s": 0.1}, set(VIDEO_STAGES) - {LOOK}),
        ({"method": "clustering"}, {ASSOCIATE} | FROM_PLACES),
        ({"smoothing": "none"}, {FIT, HOLD, EXPORT}),
        ({"feet": "off"}, {HOLD, EXPORT}),
        ({"joint_centers": "off"}, {FIT, HOLD, EXPORT}),
        ({"refine_calibration": "auto"}, {ASSOCIATE} | FROM_PLACES),
        ({"exports": ("glb",)}, {EXPORT}),
    ],
)
def test_choice_changes_keys_of_its_stage_and_later_ones(choice: dict[str, Any], changed: set[str]) -> None:
    ours, other = keys(make_session()), keys(make_session(), JobSpec(**choice))
    assert {name for name in ours if ours[name] != other.get(name)} == changed


@pytest.mark.parametrize(
    ("stage", "changed"),
    [(LOOK, set(VIDEO_STAGES)), (DETECT, set(VIDEO_STAGES) - {LOOK}), (FIT, {FIT, HOLD, EXPORT}), (EXPORT, {EXPORT})],
)
def test_new_code_changes_keys_of_its_stage_and_later_ones(stage: str, changed: set[str]) -> None:
    before = keys(make_session())
    after = keys(make_session(), codes={**stage_codes(), stage: "other"})
    assert {name for name in before if before[name] != after[name]} == changed


def test_choice_that_no_stage_names_counts_for_all() -> None:
    @dataclass(frozen=True)
    class NewConfig(ReconstructionConfig):
        new_choice: int = 1

    facts, codes = session_facts(make_session()), stage_codes()
    first, second = (plan(facts, NewConfig(new_choice=value), codes) for value in (1, 2))
    for one, other in zip(first, second, strict=True):
        assert next(iter(one.tasks)).key != next(iter(other.tasks)).key


def test_every_choice_is_named_by_stage() -> None:
    """A choice that counts for all stages makes detections anew when it changes."""
    named = {name for stage in STAGES for name in stage.choices}
    assert set(effective_choices(ReconstructionConfig())) == named


def test_keys_are_unique_and_safe_as_names() -> None:
    found = [key for stage in keys(make_session(1000)).values() for key in stage]
    assert len(set(found)) == len(found)
    assert all(len(key) == 64 and key.isalnum() for key in found)


def test_keypoints_need_no_detection_and_their_clock_is_input() -> None:
    files = tuple(replace(file, kind="keypoints") if file.kind == "video" else file for file in FILES)
    session, slower = make_session(files=files), make_session(files=files, rates_hz=(20.0, 20.0))
    assert list(keys(session)) == [CHECK, ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT]
    assert list(keys(session, CLUSTERING)) == [CHECK, LENGTHS, POSES, ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT]
    assert all(keys(session)[stage] != keys(slower)[stage] for stage in (ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT))


def test_detectors_with_fields_are_in_registry() -> None:
    for name in NETWORKS:
        entry = REGISTRY[name]
        spec = JobSpec.model_validate({"method": "clustering", "detector": name})
        assert spec.config.uses_fields == (entry.fields is not None)
        assert bool(method_warnings(spec.config, has_videos=True)) == (entry.fields is None)
        assert method_warnings(spec.config, has_videos=False)
        assert not method_warnings(JobSpec.model_validate({"detector": name}).config, has_videos=False)


def test_statements_about_videos_are_input() -> None:
    def said(offset_s: float, std_s: float | None = None) -> Session:
        plain = make_session()
        recordings = (Recording("0", offset_s=offset_s, offset_std_s=std_s),)
        return replace(plain, preflight=replace(plain.preflight, recordings=recordings))

    plain = make_session()
    in_mm = replace(plain, preflight=replace(plain.preflight, units="mm"))
    turned = replace(plain, preflight=replace(plain.preflight, up="-y"))
    found = [
        keys(plain),
        keys(said(offset_s=0.1)),
        keys(said(offset_s=0.2)),
        keys(said(0.2, 0.01)),
        keys(in_mm),
        keys(turned),
    ]
    for stage in found[0]:
        assert len({key for keys_by_stage in found for key in keys_by_stage[stage]}) == len(found) * len(
            found[0][stage]
        )


@given(num_frames=st.integers(1, 500), chunk_frames=st.integers(1, 60), data=st.data())
def test_of_frames_that_are_wanted_each_is_there_once(num_frames: int, chunk_frames: int, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, num_frames - 1))
    stop = data.draw(st.integers(start + 1, num_frames))
    session, spec = make_session(num_frames), JobSpec(method="clustering", frame_range=(start, stop))
    _, detect, _, _, poses, *_ = plan_job(replace(session, chunk_frames=chunk_frames), spec)
    ranges = [(one.start, one.stop) for one in FrameCut(range(start, stop), (range(num_frames),), chunk_frames)]
    for camera in ("0", "1"):
        payloads = [chunk.payload for chunk in detect.chunks if chunk.payload["camera"] == camera]
        assert [(one["start_frame"], one["stop_frame"]) for one in payloads] == ranges
    found = [(chunk.payload["start_frame"], chunk.payload["stop_frame"]) for chunk in poses.chunks]
    assert found == ranges
    assert [frame for one in ranges for frame in range(*one)] == list(range(start, stop))


def test_part_of_session_reuses_outputs_of_whole() -> None:
    whole, part = keys(make_session(100)), keys(make_session(100), JobSpec(frame_range=(25, 90)))
    assert whole[DETECT][2:6] == part[DETECT][:4]  # 25-50 and 50-75 of both cameras
    assert not set(whole[DETECT]) & set(part[DETECT][4:])  # 75-90
    assert all(whole[stage] != part[stage] for stage in (ASSOCIATE, IDENTIFY, FIT, HOLD, EXPORT))


def test_number_of_people_counts_from_global_pass_on() -> None:
    everybody, two = keys(make_session()), keys(make_session(), JobSpec(people=2))
    assert {name for name in two if two[name] != everybody[name]} == FROM_PLACES


def paused(num_frames: int, stretches: list[list[int]], **changes: Any) -> Session:
    plain = make_session(num_frames, **changes)
    return replace(plain, preflight=replace(plain.preflight, stretches=tuple(range(*one) for one in stretches)))


def ranges_of(stage: StagePlan) -> list[tuple[int, int]]:
    payloads = [chunk.payload for chunk in stage.chunks]
    return list(dict.fromkeys((one["start_frame"], one["stop_frame"]) for one in payloads))


def test_pauses_have_no_chunks() -> None:
    session = paused(900_000, [[0, 60], [899_950, 900_000]])
    _, detect, _, lengths, poses, *_ = plan_job(replace(session, chunk_frames=25), CLUSTERING)
    assert (
        ranges_of(detect) == ranges_of(poses) == [(0, 25), (25, 50), (50, 75), (899_950, 899_975), (899_975, 900_000)]
    )
    assert next(iter(lengths.chunks)).unit_count == round(5 * 110 / 25)


def test_stretches_within_one_range_share_its_chunk() -> None:
    _, detect, *_ = plan_job(replace(paused(1000, [[0, 10], [30, 40], [90, 120]]), chunk_frames=50), JobSpec())
    assert ranges_of(detect) == [(0, 50), (50, 100), (100, 150)]


def test_frames_of_pause_alone_have_chunk_all_same() -> None:
    _, detect, *_ = plan_job(paused(900_000, [[0, 60]]), JobSpec(frame_range=(5000, 9000)))
    assert ranges_of(detect) == [(5000, 5100)]


def test_longest_session_has_bounded_number_of_chunks() -> None:
    session = make_session(MAX_OUTPUT_FRAMES, rates_hz=(25.0,) * 64)
    _, detect, *_ = plan_job(replace(session, chunk_frames=1), JobSpec())
    assert sum(1 for _ in detect.chunks) <= MAX_TASKS
    part, *_ = plan_job(replace(session, chunk_frames=1), JobSpec(frame_range=(0, 10_000)))
    assert ranges_of(part)[:-1] == ranges_of(detect)[: len(ranges_of(part)) - 1]  # jobs of a session cut alike


def test_plan_takes_no_memory() -> None:
    session = make_session(MAX_OUTPUT_FRAMES)
    tracemalloc.start()
    try:
        stages = plan_job(session, CLUSTERING)
        assert sum(1 for stage in stages for _ in stage.chunks) > 20_000
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_proxies_are_made_of_some_cameras_and_of_nothing_else() -> None:
    session = make_session(100, (50.0, 25.0, 25.0))
    (stage,) = plan_job(session, JobSpec(), making=ProxyChoices(("2", "0")))
    chunks = list(stage.chunks)
    assert stage.name == PROXY
    assert [(chunk.index, chunk.payload["camera"], chunk.unit_count) for chunk in chunks] == [
        (0, "0", 100),
        (1, "2", 50),
    ]
    assert PROXY not in [planned.name for planned in plan_job(session, JobSpec())]


def test_overlays_are_drawn_of_each_camera_if_asked_for() -> None:
    session = make_session(100, (50.0, 25.0))
    overlaid = JobSpec(overlay=True, frame_range=(40, 80))
    names = [stage.name for stage in plan_job(session, overlaid)]
    assert names == [*VIDEO_STAGES[:-1], OVERLAY, EXPORT]
    (stage,) = (one for one in plan_job(session, overlaid) if one.name == OVERLAY)
    chunks = [(one.payload["camera"], one.payload["start_frame"], one.unit_count) for one in stage.chunks]
    assert chunks == [("0", 40, 40), ("1", 40, 20)]
    with_overlay, without = keys(session, overlaid), keys(session, JobSpec(frame_range=(40, 80)))
    assert {name: with_overlay[name] for name in without} == without
    assert OVERLAY not in keys(session)
    assert keys(session, JobSpec(report=True, overlay=True)).keys() - keys(session).keys() == {OVERLAY, REPORT}
    recorded, plain = keys(session, JobSpec(exports=("bvh", "rerun"))), keys(session, JobSpec(exports=("bvh",)))
    assert recorded.keys() - plain.keys() == {RECORD}


def test_blurred_heads_change_keys_of_pictures_alone() -> None:
    session = make_session(100, (50.0, 25.0))
    plain = keys(session, JobSpec(report=True, overlay=True))
    blurred = keys(session, JobSpec(report=True, overlay=True, blur_faces=True))
    assert blurred.keys() - plain.keys() == {HEADS, BLUR}
    assert {name for name in plain if plain[name] != blurred[name]} == {OVERLAY, REPORT}
    recordings = [JobSpec(exports=("rerun",), blur_faces=blur_faces) for blur_faces in (False, True)]
    assert len({keys(session, spec)[RECORD][0] for spec in recordings}) == 2
    (stage,) = (stage for stage in plan_job(session, JobSpec(blur_faces=True)) if stage.name == BLUR)
    assert [(chunk.payload["camera"], chunk.unit_count) for chunk in stage.chunks] == [("0", 100), ("1", 50)]
    keypoints = replace(session, files=(replace(session.files[0], kind="keypoints"), *session.files[1:]))
    assert not {HEADS, BLUR} & {planned.name for planned in plan_job(keypoints, JobSpec(blur_faces=True))}


def test_stages_with_networks_alone_depend_on_execution_provider() -> None:
    """No output of another provider is taken, and no worker with another one runs the chunks."""
    on_cpu, on_gpu = (plan_job(make_session(), JobSpec(), provider=provider) for provider in ("", "cuda 1.31.1"))
    with_networks = {stage.name for stage in STAGES if stage.runs_networks}
    assert with_networks == {LOOK, DETECT, REDETECT}
    for before, after in zip(on_cpu, on_gpu, strict=True):
        runs_networks = before.name in with_networks
        assert after.provider == ("cuda 1.31.1" if runs_networks else "")
        assert (before.code_sha256 != after.code_sha256) is runs_networks
        # All stages read what the networks found.
        assert [chunk.output_key for chunk in before.chunks] != [chunk.output_key for chunk in after.chunks]
    assert {stage.code_sha256 for stage in on_gpu} <= set(stage_codes("cuda 1.31.1").values())


def test_jobs_of_session_are_cut_alike() -> None:
    session = make_session(1000, chunk_frames=250)
    _, detect, *_ = plan_job(session, JobSpec())
    assert [chunk.payload["start_frame"] for chunk in detect.chunks] == [0, 0, 250, 250, 500, 500, 750, 750]
