"""Codes of findings of the check of a session."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode

_FINDING = ("finding",)
# Findings that are warnings of a job, too.
_PEOPLE = ("finding", "warning")

FILES = CodeGroup(
    "Findings about files",
    "Codes of `preflight.findings` of a session and of `multicap check`, from the files alone. A finding never refuses "
    "a session; [preflight](preflight.md) describes the evidence of each. Findings about the cameras have the codes of "
    "[findings about calibrations](#findings-of-checks).",
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
            "keypoints_form",
            _FINDING,
            "Keypoint files of another program than OpenPose were recognised by their content.",
            "Check that they are of this program.",
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
        ProblemCode(
            "frames_dropped",
            _FINDING,
            "Frames of a video are missing: its times have gaps.",
            "Nothing is to be done for slow motion; else record with a camera that keeps its rate.",
        ),
        ProblemCode(
            "frames_too_close",
            _FINDING,
            "Frames of a video follow the one before at once.",
            "Check what wrote the times of the video.",
        ),
        ProblemCode(
            "frame_rate_varies",
            _FINDING,
            "The frame rate of a video varies.",
            "Record at a constant rate for fast motion.",
        ),
        ProblemCode(
            "coarse_clock",
            _FINDING,
            "The clock of the videos' starts is coarser than their frames.",
            "State offsets, or synchronise by the people.",
        ),
        ProblemCode(
            "interlaced_video",
            _FINDING,
            "A video is interlaced: each picture shows two instants.",
            "Record progressively, or deinterlace the video before.",
        ),
        ProblemCode(
            "pixel_aspect",
            _FINDING,
            "The pixels of a video are not square; its pictures are scaled.",
            "See [formats](formats.md#videos); check that the calibration is of one of the two sizes.",
        ),
        ProblemCode(
            "picture_dark",
            _FINDING,
            "The picture of a camera is too dark.",
            "Light the scene, open the aperture or expose longer.",
        ),
        ProblemCode(
            "picture_blurred",
            _FINDING,
            "The picture of a camera is blurred.",
            "Focus on the place where people are; clean the lens; send the video as the camera recorded it.",
        ),
        ProblemCode(
            "picture_frozen",
            _FINDING,
            "The picture of a camera stays the same while another camera sees motion.",
            "Look at the video; export it again, or leave the camera out.",
        ),
        ProblemCode(
            "pictures_left_out",
            _FINDING,
            "The service had no time or memory to look at all pictures.",
            "Send the session again when the service is less busy to have all pictures looked at.",
        ),
        ProblemCode("session_warning", _FINDING, "A warning of a version that had sentences only.", "Read `message`."),
    ),
)

PEOPLE = CodeGroup(
    "Findings about people",
    "Codes of findings of `multicap check`, and of warnings of a job, from the people whom the cameras see at twelve "
    "instants. Findings about the world have the codes of [warnings of a result](#warnings-of-a-result).",
    (
        ProblemCode(
            "nobody_detected",
            _PEOPLE,
            "The detector found people in no camera, or in one alone.",
            "See that people are in the pictures, upright, bright and large enough.",
        ),
        ProblemCode(
            "camera_sees_nobody",
            _PEOPLE,
            "The detector found nobody in a camera, and people in others.",
            "See that the camera looks at the people.",
        ),
        ProblemCode(
            "clocks_disagree",
            _PEOPLE,
            "The declared times of a camera are wrong by more than half a frame.",
            "Synchronise by the people with `sync: auto`, or correct the offset.",
        ),
        ProblemCode(
            "clock_measured",
            _FINDING,
            "`multicap check --sync auto` measured the offset of a camera.",
            "Reconstruct with `sync: auto`, or declare the offset.",
        ),
        ProblemCode(
            "same_video", _PEOPLE, "Two cameras have the same video or keypoints.", "Give each camera its own video."
        ),
        ProblemCode(
            "cameras_exchanged",
            _PEOPLE,
            "The video of a camera fits the calibration of another camera.",
            "Exchange the videos, or the entries of the calibration.",
        ),
        ProblemCode(
            "picture_turned",
            _PEOPLE,
            "The picture of a camera is turned against its calibration.",
            "Turn the video, or calibrate the camera as it is turned.",
        ),
        ProblemCode(
            "picture_mirrored",
            _PEOPLE,
            "The picture of a camera is mirrored against its calibration.",
            "Turn off the mirroring, or mirror the video back.",
        ),
        ProblemCode(
            "calibration_of_another_rig",
            _PEOPLE,
            "No two cameras agree about people.",
            "Give the calibration of these cameras; check the synchronisation.",
        ),
        ProblemCode(
            "no_common_people",
            _PEOPLE,
            "A camera sees people, and never at the same time as another camera.",
            "Check its offset, and where it looks.",
        ),
    ),
)
