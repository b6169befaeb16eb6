"""Problem codes of specs and jobs, of the service's readiness, and of warnings."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode
from pipeline.config import FILE_FORMATS, unlimited_alternatives

_SPEC = ("422", "command")
_WARNING = ("warning",)
_WARNING_AND_FINDING = ("warning", "finding")
_READYZ = ("readyz",)
_SYNC = ("job", "command")

SPECS = CodeGroup(
    "Spec of a job",
    "Values of `code` in `errors`, also for the options of `multicap reconstruct`.",
    (
        ProblemCode(
            "frame_range", _SPEC, "The session does not have these output frames.", "Use frames of the session."
        ),
        ProblemCode("cutoff_range", _SPEC, "The cutoff is not below half of the frame rate.", "Use 6 Hz."),
        *(
            ProblemCode(
                f"too_long_for_{name}",
                _SPEC,
                f"A {name.upper()} file holds at most {file_format.max_frames:,} frames.",
                f"Use {' or '.join(f'`{other}`' for other in unlimited_alternatives(name))}.",
            )
            for name, file_format in FILE_FORMATS.items()
            if file_format.max_frames is not None
        ),
        ProblemCode(
            "detector_not_installed",
            ("422",),
            "Not every ready worker has the networks of the job.",
            "The operator runs the command in `hint` on the workers' machine.",
        ),
        ProblemCode("callback_invalid", ("422",), "`callback_url` has an impossible host or port.", "Correct it."),
        ProblemCode("callback_not_https", ("422",), "`callback_url` is not https.", "Use https."),
        ProblemCode(
            "callback_not_public", ("422",), "`callback_url` is not a public address.", "Use a public address."
        ),
        ProblemCode(
            "webhook_secret_missing",
            ("422",),
            "The tenant has no secret that signs webhooks.",
            "The operator runs `multicap webhooks rotate`.",
        ),
    ),
)

EDITS = CodeGroup(
    "Edits of people",
    "Values of `code` in `errors` of `PATCH /v1/jobs/{id}/people`; `pointer` leads to the edit.",
    (
        ProblemCode(
            "edit_impossible",
            ("422",),
            "The edit can't be made at this point: there is no such person, or no such frame.",
            "Read the people again. Each edit is applied to the people whom the edits before it leave.",
        ),
        ProblemCode(
            "edits_fragmented",
            ("422",),
            "After this edit the people would consist of more pieces of the people who were found than are allowed.",
            "Leave this edit and those after it out, or exchange people in fewer places.",
        ),
    ),
)

JOBS = CodeGroup(
    "Errors of jobs",
    "Values of `error.code` of a failed job, and of a failed attempt in `GET /v1/jobs/{id}/attempts`. Problems of "
    "videos marked `job` above can be a job's error too. `retryable` states whether another attempt may succeed.",
    (
        ProblemCode(
            "worker_lost",
            ("job", "attempt"),
            "A worker stopped responding while it worked on a chunk, most often for lack of memory.",
            "Run fewer workers, then retry the job.",
        ),
        ProblemCode(
            "memory_limit",
            ("job",),
            "A chunk needs more memory than a worker may use.",
            "Use fewer frames, or have the operator raise `MULTICAP_MEMORY_BYTES`.",
        ),
        ProblemCode(
            "input_damaged",
            ("job",),
            "The service's copy of an input file is damaged or missing.",
            "Send the session again, or restore the file from a backup and retry the job.",
        ),
        ProblemCode(
            "output_damaged",
            ("job", "attempt"),
            "A stored output of a stage was damaged.",
            "The operator checks the disk; then retry the job.",
        ),
        ProblemCode(
            "sync_no_motion",
            _SYNC,
            "A camera sees nobody who moves, or too little motion to tell its offset.",
            "Declare the offsets, or film people who move; see [synchronization](synchronization.md#refusals).",
        ),
        ProblemCode(
            "sync_ambiguous",
            _SYNC,
            "The motion that a camera sees fits several offsets.",
            "Declare the offsets, or film other motion; see [synchronization](synchronization.md#refusals).",
        ),
        ProblemCode(
            "sync_contradiction",
            _SYNC,
            "The sound of a camera and the motion of people tell different offsets.",
            "Declare the offsets, or send videos without sound; see [synchronization](synchronization.md#refusals).",
        ),
        ProblemCode(
            "sync_little_overlap",
            _SYNC,
            "A camera recorded for too short a time together with the others.",
            "Declare the offsets.",
        ),
        ProblemCode(
            "sync_nothing_in_common",
            _SYNC,
            "No motion that a camera sees fits the other cameras, at any offset.",
            "Check that it sees the same people, and its calibration; or declare the offsets.",
        ),
        ProblemCode(
            "sync_imprecise",
            _SYNC,
            "The offset of a camera is known to more than half a frame only.",
            "Declare the offsets, or film people who move.",
        ),
        ProblemCode(
            "sync_needs_bodies",
            _SYNC,
            "Cameras are synchronised from whole bodies; the detector finds single joints.",
            "Use `detector: auto`, or declare the offsets.",
        ),
        ProblemCode(
            "input_error", ("job",), "The input has several problems.", "Correct everything that `detail` lists."
        ),
        ProblemCode(
            "model_error",
            ("job", "command"),
            "A detector network or the sample capture can't be installed or used.",
            "Follow the message, then retry.",
        ),
        ProblemCode(
            "child_failed",
            ("job", "command"),
            "A process of Multicap failed; the input is not the cause.",
            "Retry; if the process fails again, see the log.",
        ),
        ProblemCode(
            "pipeline_error",
            ("job", "command"),
            "The reconstruction failed; the message states the reason.",
            "Follow the message.",
        ),
    ),
)

READINESS = CodeGroup(
    "Readiness",
    "Values of `code` in the `errors` of a 503 of `GET /readyz`, beside `database_unavailable`, `database_damaged`, "
    "`artifacts_unavailable` and `storage_full` above.",
    (
        ProblemCode(
            "broker_unavailable",
            (*_READYZ, "waiting"),
            "The broker does not respond. Queued work waits for it.",
            "Start the broker.",
        ),
        ProblemCode(
            "disk_unavailable",
            _READYZ,
            "The disk of the data folder does not respond.",
            "Check the disk, or the machine that shares it.",
        ),
        ProblemCode("worker_unavailable", _READYZ, "No worker runs.", "Start a worker, and see its log."),
        ProblemCode("worker_starting", _READYZ, "The workers are starting; `message` states their progress.", "Wait."),
        ProblemCode(
            "model_unavailable",
            _READYZ,
            "A worker lacks a network of the default profile.",
            "Run the command in `hint` on the workers' machine.",
        ),
    ),
)

WARNINGS = CodeGroup(
    "Warnings of a result",
    "Codes of `result_warnings` of a job, and of `capture_checks` and `world_checks` in `metrics.json`. The result "
    "files exist, but the capture or the calibration may be wrong.",
    (
        ProblemCode(
            "nobody_found",
            _WARNING_AND_FINDING,
            "No person was found.",
            "Check that the calibration belongs to the videos, and that two cameras see a person at the same time.",
        ),
        ProblemCode(
            "everybody_removed",
            _WARNING,
            "Edits removed everybody who was found.",
            "Undo an edit: `PATCH /v1/jobs/{id}/people` with the list without it.",
        ),
        ProblemCode(
            "too_few_cameras", _WARNING_AND_FINDING, "The session has fewer than three cameras.", "Add a camera."
        ),
        ProblemCode(
            "damaged_video",
            _WARNING,
            "Videos have damaged or missing frames.",
            "Copy the files again; see [formats](formats.md#videos).",
        ),
        ProblemCode(
            "frames_doubled",
            _WARNING,
            "Frames of a video show the picture before once more: people lag behind there.",
            "Record with a camera that keeps its rate, or export without a constant rate.",
        ),
        ProblemCode(
            "camera_without_people",
            _WARNING_AND_FINDING,
            "A camera was matched with no person.",
            "Check its video, its calibration and its offset.",
        ),
        ProblemCode(
            "few_views", _WARNING, "Fewer than three cameras saw a person in most frames.", "Add or move cameras."
        ),
        ProblemCode(
            "approximate_association",
            _WARNING,
            "Some frames show more people than exact methods can tell apart.",
            "Check these frames; see [tracking](tracking.md#crowds) and [clustering](clustering.md#crowds).",
        ),
        ProblemCode(
            "uncertain_identity",
            _WARNING,
            "Two people may have been taken for each other at some moment.",
            "Look at the moments under `identity.doubts` in metrics.json; see [who is who](identity.md#doubts).",
        ),
        ProblemCode(
            "calibration_refined",
            _WARNING,
            "Cameras were moved to fit the people of the take.",
            "Use the result calibration.json for other takes; see [refinement](calibration.md#refinement).",
        ),
        ProblemCode(
            "world_leveled",
            _WARNING,
            "The floor was tilted or not at z = 0, and the world was moved so that feet stand at z = 0.",
            "Use the result calibration.json for other takes; see [refinement](calibration.md#refinement).",
        ),
        ProblemCode(
            "camera_bumped",
            _WARNING,
            "A camera was moved during the take.",
            "Reconstruct the frames before and after the time in the message on their own (`frame_range`).",
        ),
        ProblemCode(
            "sync_by_sound",
            _WARNING,
            "The offsets of the cameras are those of their sound alone.",
            "Look at the motion; declare the offset, or film people who move where all cameras see them.",
        ),
        ProblemCode(
            "sync_uncertain",
            _WARNING,
            "The measured clock of a camera may be wrong by up to half a frame.",
            "Look at the motion; declare the offset, or film people who move where all cameras see them.",
        ),
        ProblemCode(
            "people_few_views",
            _WARNING,
            "A camera shares people with another camera briefly.",
            "Let people walk where it and a neighbour see them.",
        ),
        ProblemCode(
            "people_poor_fit",
            _WARNING,
            "People fit a camera worse than the other cameras.",
            "Check its synchronisation, whether it moved, and its intrinsics.",
        ),
        ProblemCode(
            "people_same_place",
            _WARNING,
            "Two cameras come out at nearly the same place.",
            "Check whether one video was given twice.",
        ),
        ProblemCode(
            "people_uncertain_pose",
            _WARNING,
            "People determine the pose of a camera poorly.",
            "Film longer, with people all over the place.",
        ),
        ProblemCode(
            "people_uncertain_focal",
            _WARNING,
            "People determine the focal length of a camera poorly.",
            "Give the intrinsics, or calibrate them from a board.",
        ),
        ProblemCode(
            "people_uncertain_floor",
            _WARNING,
            "The feet reach too little ground to find its slope.",
            "Let people walk all over the place.",
        ),
        ProblemCode(
            "board_few_views",
            _WARNING,
            "The board was found in few pictures of a camera.",
            "Film it longer, at several distances and tilts.",
        ),
        ProblemCode(
            "board_poor_coverage",
            _WARNING,
            "The board covers a small part of a camera's picture.",
            "Film it near the edges and corners too; see the picture `coverage_CAMERA.svg`.",
        ),
        ProblemCode(
            "board_mirrored",
            _WARNING,
            "The board is mirrored in some pictures.",
            "Turn off the mirroring of the camera: its videos are mirrored too.",
        ),
        ProblemCode(
            "board_ambiguous",
            _WARNING,
            "The chessboard looks the same after half a turn, so that the world may be turned by half a turn.",
            "Use a board with an odd and an even number, a ChArUco board, or known points.",
        ),
        ProblemCode(
            "board_few_shared",
            _WARNING,
            "A camera is linked to the others by few views of the board.",
            "Film the board where the camera and a neighbour both see it.",
        ),
        ProblemCode(
            "board_floor_uncertain",
            _WARNING,
            "The board never lies still on the floor, so that the floor of the world is a guess.",
            "Lay it flat on the floor for a second, or state the time (`--floor-time`).",
        ),
        ProblemCode(
            "known_points_doubtful",
            _WARNING,
            "A known point is far from where the cameras see it, or all cameras are below the points.",
            "Check its coordinates and its marked pixels, and that Z points up.",
        ),
        ProblemCode(
            "upside_down", _WARNING_AND_FINDING, "Heads are below feet.", "Turn the calibration: Z must point up."
        ),
        ProblemCode(
            "not_upright",
            _WARNING_AND_FINDING,
            "People lean in most frames.",
            "Check that the calibration's up axis is Z.",
        ),
        ProblemCode(
            "floor_not_at_zero",
            _WARNING_AND_FINDING,
            "Feet do not stand at a height of 0.",
            "Move the calibration's origin.",
        ),
        ProblemCode(
            "floor_tilted", _WARNING_AND_FINDING, "The floor that feet stand on is tilted.", "Level the calibration."
        ),
        ProblemCode(
            "stature_out_of_range",
            _WARNING_AND_FINDING,
            "A person is not 1.0 to 2.3 m tall.",
            "Check the calibration's unit.",
        ),
        ProblemCode(
            "camera_below_floor", _WARNING_AND_FINDING, "A camera is below the floor.", "Check the calibration's axes."
        ),
        ProblemCode(
            "mirrored_world",
            _WARNING_AND_FINDING,
            "People's left and right are exchanged.",
            "Check the signs of the calibration's axes, and that the videos are not mirrored.",
        ),
        ProblemCode(
            "camera_disagrees",
            _WARNING_AND_FINDING,
            "A camera sees people elsewhere than the other cameras do.",
            "Refine the calibration; see [refinement](calibration.md#refinement). Or check the camera's offset.",
        ),
    ),
)
