"""Problem codes that only the command line has."""

from pipeline.core.problems.model import CodeGroup

_COMMAND = ("command",)

COMMANDS = CodeGroup(
    "Command line",
    'With `--json` a command prints `{"problems": [{"code", "message", ...}]}`. The exit code is 2 for wrong input and '
    "1 for other failures.",
)

SOURCES = COMMANDS.code(
    "sources",
    _COMMAND,
    "Options of videos and of keypoints were mixed, or neither was given.",
    "Give `--videos`, with `--offset` if needed, or `--keypoints`, with `--timestamps` or `--frame-rate`.",
)
UNKNOWN_CLOCK = COMMANDS.code(
    "unknown_clock", _COMMAND, "There is no such clock of videos.", "Use a name that `hint` lists."
)
UNKNOWN_UNITS = COMMANDS.code("unknown_units", _COMMAND, "There is no such unit.", "Use a name that `hint` lists.")
UNKNOWN_AXIS = COMMANDS.code("unknown_axis", _COMMAND, "There is no such axis.", "Use a name that `hint` lists.")
UNKNOWN_PROVIDER = COMMANDS.code(
    "unknown_provider", _COMMAND, "There is no such execution provider.", "Use a name that `hint` lists."
)
UNKNOWN_SCENE = COMMANDS.code(
    "unknown_scene", _COMMAND, "There is no such simulated scene.", "Use a name that `hint` lists."
)
UNKNOWN_JOINTS = COMMANDS.code(
    "unknown_joints", _COMMAND, "Simulated people have no such joints.", "Use a name that `hint` lists."
)
UNKNOWN_EVIDENCE = COMMANDS.code(
    "unknown_evidence", _COMMAND, "There is no such evidence for the method.", "Omit it, or use the hint."
)
UNKNOWN_PARAMETER = COMMANDS.code(
    "unknown_parameter",
    _COMMAND,
    "The method has no parameter of this name.",
    "Use a name of [tracking](tracking.md#parameters) or [clustering](clustering.md#parameters).",
)
PARAMETER_RANGE = COMMANDS.code(
    "parameter_range", _COMMAND, "The value of the parameter is not allowed.", "Use an allowed value."
)
PARAMETER_UNREADABLE = COMMANDS.code(
    "parameter_unreadable", _COMMAND, "The option is not NAME=NUMBER, or not WIDTHxHEIGHT.", "Write it as in the hint."
)
NO_REFINEMENT = COMMANDS.code(
    "no_refinement",
    _COMMAND,
    "The evaluation refines calibrations from whole bodies only.",
    "Use `--evidence bodies`, or omit `--turn`, `--shift` and `--refine-calibration`.",
)
NO_ABLATION = COMMANDS.code("no_ablation", _COMMAND, "The method has no ablation here.", "Omit `--ablation`.")
WRONG_NUMBER_OF_VIEWS = COMMANDS.code(
    "wrong_number_of_views", _COMMAND, "The scene does not have so many cameras.", "Ask for fewer."
)
NEGATIVE_SEED = COMMANDS.code("negative_seed", _COMMAND, "The seed is negative.", "Use 0 or more.")
DATASET_INCOMPLETE = COMMANDS.code(
    "dataset_incomplete", _COMMAND, "Files of the dataset are missing.", "Get the whole dataset."
)
BENCHMARK_UNREADABLE = COMMANDS.code(
    "benchmark_unreadable", _COMMAND, "A file of a benchmark can't be read.", "Follow the message: get the file again."
)
TRUTH_UNREADABLE = COMMANDS.code(
    "truth_unreadable", _COMMAND, "The rendered capture's truth can't be read.", "Get it again."
)
SERVICE_ERROR = COMMANDS.code(
    "service_error", _COMMAND, "The service refused, failed or did not start.", "Follow the message."
)
BAD_USAGE = COMMANDS.code("bad_usage", _COMMAND, "`multicap backup` was called wrongly.", "Follow the message.")
BACKUP_FAILED = COMMANDS.code(
    "backup_failed", _COMMAND, "The backup could not be made, read or restored.", "Follow the message."
)
INTERRUPTED = COMMANDS.code("interrupted", _COMMAND, "The command was interrupted by a signal.", "Start it again.")
TAKES_UNREADABLE = COMMANDS.code(
    "takes_unreadable",
    _COMMAND,
    "A batch has no takes, or its list of takes can't be read.",
    "Give a folder with a folder for each take, or a list as in [many takes](formats.md#many-takes).",
)
TAKE_EMPTY = COMMANDS.code(
    "take_empty",
    _COMMAND,
    "A take has neither videos nor folders of keypoints.",
    "Put the videos of all cameras, or the folder `keypoints`, into the folder of the take.",
)
TAKE_UNCALIBRATED = COMMANDS.code(
    "take_uncalibrated",
    _COMMAND,
    "A take has no calibration.",
    "Give `--calibration`, or put a file `calibration.*` into the take.",
)
OUTPUT_EXISTS = COMMANDS.code(
    "output_exists",
    _COMMAND,
    "A new file is there already, or the folder for new files has files.",
    "Name a new file, and a new or empty folder.",
)
