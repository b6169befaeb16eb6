"""Problem codes of specs of jobs."""

from pipeline.core.problems.model import CodeGroup

_SPEC = ("422", "command")

SPECS = CodeGroup("Spec of a job", "Values of `code` in `errors`, also for the options of `multicap reconstruct`.")

FRAME_RANGE = SPECS.code(
    "frame_range", _SPEC, "The session does not have these output frames.", "Use frames of the session."
)
CUTOFF_RANGE = SPECS.code("cutoff_range", _SPEC, "The cutoff is not below half of the frame rate.", "Use 6 Hz.")
FORMAT_NOT_INSTALLED = SPECS.code(
    "format_not_installed",
    _SPEC,
    "The package that writes a format is not installed, or not on every ready worker.",
    "Run the command in `hint`, of a service on the workers' machine, or use another format.",
)
DETECTOR_NOT_INSTALLED = SPECS.code(
    "detector_not_installed",
    ("422",),
    "Not every ready worker has the networks of the job.",
    "The operator runs the command in `hint` on the workers' machine.",
)
BODY_NOT_INSTALLED = SPECS.code(
    "body_not_installed",
    ("422",),
    "Not every ready worker has the body that the job's files shall have.",
    "The operator runs the command in `hint` on the workers' machine; or choose `capsules`.",
)
CHARACTER_UNKNOWN = SPECS.code(
    "character_unknown", ("422",), "There is no character with this id.", "List the characters, or send the file."
)
CALLBACK_INVALID = SPECS.code(
    "callback_invalid", ("422",), "`callback_url` has an impossible host or port.", "Correct it."
)
CALLBACK_NOT_HTTPS = SPECS.code("callback_not_https", ("422",), "`callback_url` is not https.", "Use https.")
CALLBACK_NOT_PUBLIC = SPECS.code(
    "callback_not_public", ("422",), "`callback_url` is not a public address.", "Use a public address."
)
WEBHOOK_SECRET_MISSING = SPECS.code(
    "webhook_secret_missing",
    ("422",),
    "The tenant has no secret that signs webhooks.",
    "The operator runs `multicap webhooks rotate`.",
)
