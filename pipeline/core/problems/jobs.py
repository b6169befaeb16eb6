"""Problem codes of edits and jobs, and of the service's readiness."""

from pipeline.core.problems.model import CodeGroup

_READYZ = ("readyz",)
_SYNC = ("job", "command")

EDITS = CodeGroup(
    "Edits of people", "Values of `code` in `errors` of `PATCH /v1/jobs/{id}/people`; `pointer` leads to the edit."
)

EDIT_IMPOSSIBLE = EDITS.code(
    "edit_impossible",
    ("422",),
    "The edit can't be made at this point: there is no such person, or no such frame.",
    "Read the people again. Each edit is applied to the people whom the edits before it leave.",
)
EDITS_FRAGMENTED = EDITS.code(
    "edits_fragmented",
    ("422",),
    "After this edit the people would consist of more pieces of the people who were found than are allowed.",
    "Leave this edit and those after it out, or exchange people in fewer places.",
)


JOBS = CodeGroup(
    "Errors of jobs",
    "Values of `error.code` of a failed job, and of a failed attempt in `GET /v1/jobs/{id}/attempts`. Problems of "
    "videos marked `job` above can be a job's error too. `retryable` states whether another attempt may succeed.",
)

WORKER_LOST = JOBS.code(
    "worker_lost",
    ("job", "attempt"),
    "A worker stopped responding while it worked on a chunk, most often for lack of memory.",
    "Run fewer workers, then retry the job.",
)
MEMORY_LIMIT = JOBS.code(
    "memory_limit",
    ("job", "command"),
    "A chunk needs more memory than a worker may use, or a command more than there is.",
    "Use fewer frames, or have the operator raise `MULTICAP_MEMORY_BYTES`.",
)
TIME_LIMIT = JOBS.code(
    "time_limit",
    ("job", "attempt"),
    "A chunk took many times as long as foreseen, twice, and was stopped.",
    "Retry the job. The operator reads the workers' logs, or raises `MULTICAP_CHUNK_TIME_FACTOR` on slow machines.",
)
INPUT_DAMAGED = JOBS.code(
    "input_damaged",
    ("job",),
    "The service's copy of an input file is damaged or missing.",
    "Send the session again, or restore the file from a backup and retry the job.",
)
OUTPUT_DAMAGED = JOBS.code(
    "output_damaged",
    ("job", "attempt"),
    "A stored output of a stage was damaged.",
    "The operator checks the disk; then retry the job.",
)
SYNC_NO_MOTION = JOBS.code(
    "sync_no_motion",
    _SYNC,
    "A camera sees nobody who moves, or too little motion to tell its offset.",
    "Declare the offsets, or film people who move; see [synchronization](synchronization.md#refusals).",
)
SYNC_AMBIGUOUS = JOBS.code(
    "sync_ambiguous",
    _SYNC,
    "The motion that a camera sees fits several offsets.",
    "Declare the offsets, or film other motion; see [synchronization](synchronization.md#refusals).",
)
SYNC_CONTRADICTION = JOBS.code(
    "sync_contradiction",
    _SYNC,
    "The sound of a camera and the motion of people tell different offsets.",
    "Declare the offsets, or send videos without sound; see [synchronization](synchronization.md#refusals).",
)
SYNC_LITTLE_OVERLAP = JOBS.code(
    "sync_little_overlap",
    _SYNC,
    "A camera recorded for too short a time together with the others.",
    "Declare the offsets.",
)
SYNC_NOTHING_IN_COMMON = JOBS.code(
    "sync_nothing_in_common",
    _SYNC,
    "No motion that a camera sees fits the other cameras, at any offset.",
    "Check that it sees the same people, and its calibration; or declare the offsets.",
)
SYNC_IMPRECISE = JOBS.code(
    "sync_imprecise",
    _SYNC,
    "The offset of a camera is known to more than half a frame only.",
    "Declare the offsets, or film people who move.",
)
SYNC_NEEDS_BODIES = JOBS.code(
    "sync_needs_bodies",
    _SYNC,
    "Cameras are synchronised from whole bodies; the detector finds single joints.",
    "Use `detector: auto`, or declare the offsets.",
)
INPUT_ERROR = JOBS.code(
    "input_error", ("job",), "The input has several problems.", "Correct everything that `detail` lists."
)
SESSION_REFUSED = JOBS.code(
    "session_refused",
    ("job",),
    "The check of the session found errors, which `errors` lists: a reconstruction would be wrong.",
    "Correct what they name, or reconstruct the session all the same by `force`.",
)
MODEL_ERROR = JOBS.code(
    "model_error",
    ("job", "command"),
    "A detector network or the sample capture can't be installed or used.",
    "Follow the message, then retry.",
)
CHILD_FAILED = JOBS.code(
    "child_failed",
    ("job", "command"),
    "A process of Multicap failed; the input is not the cause.",
    "Retry; if the process fails again, see the log.",
)
PIPELINE_ERROR = JOBS.code(
    "pipeline_error",
    ("job", "command"),
    "The reconstruction failed; the message states the reason.",
    "Follow the message.",
)


READINESS = CodeGroup(
    "Readiness",
    "Values of `code` in the `errors` of a 503 of `GET /readyz`, beside `database_unavailable`, `database_damaged`, "
    "`artifacts_unavailable` and `storage_full` above.",
)

BROKER_UNAVAILABLE = READINESS.code(
    "broker_unavailable",
    (*_READYZ, "waiting"),
    "The broker does not respond. Queued work waits for it.",
    "Start the broker.",
)
DISK_UNAVAILABLE = READINESS.code(
    "disk_unavailable",
    _READYZ,
    "The disk of the data folder does not respond.",
    "Check the disk, or the machine that shares it.",
)
WORKER_UNAVAILABLE = READINESS.code(
    "worker_unavailable", _READYZ, "No worker runs.", "Start a worker, and see its log."
)
WORKER_STARTING = READINESS.code(
    "worker_starting", _READYZ, "The workers are starting; `message` states their progress.", "Wait."
)
MODEL_UNAVAILABLE = READINESS.code(
    "model_unavailable",
    _READYZ,
    "A worker lacks a network of the default profile.",
    "Run the command in `hint` on the workers' machine.",
)
