"""Problem codes that only the command line has."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode
from pipeline.config import CHOICES

_COMMAND = ("command",)

COMMANDS = CodeGroup(
    "Command line",
    'With `--json` a command prints `{"problems": [{"code", "message", ...}]}`. The exit code is 2 for wrong input and '
    "1 for other failures.",
    (
        ProblemCode(
            "sources",
            _COMMAND,
            "Options of videos and of keypoints were mixed, or neither was given.",
            "Give `--videos`, with `--offset` if needed, or `--keypoints`, with `--timestamps` or `--frame-rate`.",
        ),
        *(
            ProblemCode(
                f"unknown_{choice.noun}",
                _COMMAND,
                f"`--{choice.option}` has no such value.",
                "Use a name that `hint` lists.",
            )
            for choice in CHOICES.values()
            if choice.is_checked_by_name
        ),
        ProblemCode("unknown_units", _COMMAND, "There is no such unit.", "Use a name that `hint` lists."),
        ProblemCode("unknown_scene", _COMMAND, "There is no such simulated scene.", "Use a name that `hint` lists."),
        ProblemCode(
            "unknown_evidence", _COMMAND, "There is no such evidence for the method.", "Omit it, or use the hint."
        ),
        ProblemCode(
            "unknown_parameter",
            _COMMAND,
            "The method has no parameter of this name.",
            "Use a name of [tracking](tracking.md#parameters) or [clustering](clustering.md#parameters).",
        ),
        ProblemCode("parameter_range", _COMMAND, "The value of the parameter is not allowed.", "Use an allowed value."),
        ProblemCode("parameter_unreadable", _COMMAND, "The option is not NAME=NUMBER.", "Write it as in the hint."),
        ProblemCode(
            "no_refinement",
            _COMMAND,
            "The evaluation refines calibrations from whole bodies only.",
            "Use `--evidence bodies`, or omit `--turn`, `--shift` and `--refine-calibration`.",
        ),
        ProblemCode("no_ablation", _COMMAND, "The method has no ablation here.", "Omit `--ablation`."),
        ProblemCode("wrong_number_of_views", _COMMAND, "The scene does not have so many cameras.", "Ask for fewer."),
        ProblemCode("negative_seed", _COMMAND, "The seed is negative.", "Use 0 or more."),
        ProblemCode("dataset_incomplete", _COMMAND, "Files of the dataset are missing.", "Get the whole dataset."),
        ProblemCode("benchmark_unreadable", _COMMAND, "A file of Shelf can't be read.", "Give the folder of Shelf."),
        ProblemCode("truth_unreadable", _COMMAND, "The rendered capture's truth can't be read.", "Get it again."),
        ProblemCode("service_error", _COMMAND, "The service refused, failed or did not start.", "Follow the message."),
        ProblemCode("bad_usage", _COMMAND, "`multicap backup` was called wrongly.", "Follow the message."),
        ProblemCode(
            "backup_failed", _COMMAND, "The backup could not be made, read or restored.", "Follow the message."
        ),
        ProblemCode("interrupted", _COMMAND, "The command was interrupted by a signal.", "Start it again."),
    ),
)
