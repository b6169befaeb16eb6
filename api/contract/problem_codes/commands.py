"""Problem codes that only the command line has."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode

_COMMAND = ("command",)
_FINDING = ("finding",)

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
        ProblemCode("unknown_clock", _COMMAND, "There is no such clock of videos.", "Use a name that `hint` lists."),
        ProblemCode("unknown_units", _COMMAND, "There is no such unit.", "Use a name that `hint` lists."),
        ProblemCode("unknown_scene", _COMMAND, "There is no such simulated scene.", "Use a name that `hint` lists."),
        ProblemCode(
            "unknown_joints", _COMMAND, "Simulated people have no such joints.", "Use a name that `hint` lists."
        ),
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

FINDINGS = CodeGroup(
    "Findings of checks",
    "`multicap calibration check FILE` lists what is wrong (`error`) or doubtful (`warning`) about a calibration. With "
    "videos or keypoints it lists failed checks of the people too, under the codes of warnings of a result.",
    (
        ProblemCode(
            "same_place",
            _FINDING,
            "Two cameras are at the same place; an error if they are turned alike, too.",
            "Check whether one camera stands twice in the file.",
        ),
        ProblemCode(
            "world_unit",
            _FINDING,
            "The cameras are farther apart, or closer together, than those of any rig.",
            "State the unit of the calibration.",
        ),
        ProblemCode(
            "no_common_view",
            _FINDING,
            "No other camera sees any place that the camera sees.",
            "Check the pose of the camera, or turn it to the view of the others.",
        ),
        ProblemCode(
            "focal_length",
            _FINDING,
            "The focal length does not fit the size of the picture.",
            "Check that the camera matrix belongs to this size, in pixels.",
        ),
        ProblemCode(
            "pixels_not_square",
            _FINDING,
            "The focal lengths along x and y differ.",
            "Check the camera matrix, unless the picture was stretched.",
        ),
        ProblemCode(
            "principal_point",
            _FINDING,
            "The principal point is far from the middle of the picture.",
            "Check that the camera matrix belongs to this size, and that the picture was not cropped.",
        ),
        ProblemCode(
            "distortion_folds",
            _FINDING,
            "The distortion has no inverse in a part of the picture; an error if that part is not only in the corners.",
            "Calibrate the lens again with views near the edges, or with fewer coefficients.",
        ),
    ),
)
