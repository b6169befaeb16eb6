"""Codes of findings of the check of a session."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode

_FINDING = ("finding",)

FILES = CodeGroup(
    "Findings about files",
    "Codes of `preflight.findings` of a session and of `multicap check`, from the files alone. A finding never refuses "
    "a session; [preflight](preflight.md) describes the evidence of each.",
    (
        ProblemCode("file_ignored", _FINDING, "A file is not part of the session.", "Remove it, or name it as needed."),
        ProblemCode(
            "paired_in_sorted_order",
            _FINDING,
            "No video or folder has the name of a camera, so they were paired in sorted order.",
            "Check the pairs; give the files the names of the cameras.",
        ),
        ProblemCode(
            "camera_left_out", _FINDING, "Cameras of the calibration have no video or folder.", "Add what is missing."
        ),
        ProblemCode(
            "calibration_note", _FINDING, "Something was assumed about the calibration.", "Check that it holds."
        ),
        ProblemCode(
            "calibration_adapted",
            _FINDING,
            "The video has another size than its calibration, which was adapted.",
            "Calibrate at the size of the videos if the guess is wrong.",
        ),
        ProblemCode(
            "frames_repeated",
            _FINDING,
            "Frames of a video have the timestamp of another frame.",
            "Export the video again at a constant frame rate.",
        ),
        ProblemCode(
            "frame_rate_assumed",
            _FINDING,
            "Keypoints came without a frame rate.",
            "State the frame rate, or give timestamps.",
        ),
        ProblemCode(
            "camera_saw_nobody", _FINDING, "Keypoints of a camera show nobody.", "Check the detector's output."
        ),
        ProblemCode("session_warning", _FINDING, "A warning of a version that had sentences only.", "Read `message`."),
    ),
)
