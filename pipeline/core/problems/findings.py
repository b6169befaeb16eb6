"""Codes of findings of checks."""

from pipeline.core.problems.model import CodeGroup

_FINDING = ("finding",)
# Findings that are warnings of a job, too; those that may be errors, which refuse a session.
_PEOPLE = ("finding", "warning")
_ERROR = (*_PEOPLE, "job", "command")

FILES = CodeGroup(
    "Findings about files",
    "Codes of `preflight.findings` of a session and of `multicap check`, from the files alone. None refuses "
    "a session; [preflight](preflight.md) describes the evidence of each. Findings about the cameras have the codes of "
    "[findings about calibrations](#findings-of-checks).",
)

FILE_IGNORED = FILES.code(
    "file_ignored", _FINDING, "A file is not part of the session.", "Remove it, or name it as needed."
)
PAIRED_IN_SORTED_ORDER = FILES.code(
    "paired_in_sorted_order",
    _FINDING,
    "Videos or folders were paired with cameras by the natural order of their names, as it was asked for.",
    "Check the pairs; give the files the names of the cameras.",
)
PARTS_JOINED = FILES.code(
    "parts_joined",
    _FINDING,
    "Files are joined as the parts of one camera's recording.",
    "Check that they are; state the file of the camera if they are not.",
)
CAMERA_LEFT_OUT = FILES.code(
    "camera_left_out", _FINDING, "Cameras of the calibration have no video or folder.", "Add what is missing."
)
CALIBRATION_NOTE = FILES.code(
    "calibration_note", _FINDING, "Something was assumed about the calibration.", "Check that it holds."
)
CALIBRATION_ADAPTED = FILES.code(
    "calibration_adapted",
    _FINDING,
    "The video has another size than its calibration, which was adapted.",
    "Calibrate at the size of the videos if the guess is wrong.",
)
FRAMES_REPEATED = FILES.code(
    "frames_repeated",
    _FINDING,
    "Frames of a video have the timestamp of another frame.",
    "Export the video again at a constant frame rate.",
)
KEYPOINTS_FORM = FILES.code(
    "keypoints_form",
    _FINDING,
    "Keypoint files of another program than OpenPose were recognised by their content.",
    "Check that they are of this program.",
)
KEYPOINTS_SCALE = FILES.code(
    "keypoints_scale",
    _FINDING,
    "Scores of keypoints are not from 0 to 1, or positions are not pixels of the picture, by all values of a camera.",
    "Check the scale that `message` names.",
)
CAMERA_SAW_NOBODY = FILES.code(
    "camera_saw_nobody", _FINDING, "Keypoints of a camera show nobody.", "Check the detector's output."
)
FRAMES_DROPPED = FILES.code(
    "frames_dropped",
    _FINDING,
    "Frames of a video are missing: its times have gaps. Of keypoints: the numbers of the frames do.",
    "Nothing is to be done for slow motion; else record with a camera that keeps its rate.",
)
FRAMES_TOO_CLOSE = FILES.code(
    "frames_too_close",
    _FINDING,
    "Frames of a video follow the one before at once.",
    "Check what wrote the times of the video.",
)
FRAME_RATE_VARIES = FILES.code(
    "frame_rate_varies", _FINDING, "The frame rate of a video varies.", "Record at a constant rate for fast motion."
)
SLOW_MOTION = FILES.code(
    "slow_motion",
    _FINDING,
    "A video is a whole number of times as long as the others: it seems to be slow motion.",
    "State the rate at which its camera filmed (`rate`, `--rate`), unless the camera only ran longer.",
)
COARSE_CLOCK = FILES.code(
    "coarse_clock",
    _FINDING,
    "The clock of the videos' starts is coarser than their frames.",
    "State offsets, or synchronise by the people.",
)
INTERLACED_VIDEO = FILES.code(
    "interlaced_video",
    _FINDING,
    "A video is interlaced: each picture shows two instants.",
    "Record progressively, or deinterlace the video before.",
)
PIXEL_ASPECT = FILES.code(
    "pixel_aspect",
    _FINDING,
    "The pixels of a video are not square; its pictures are scaled.",
    "See [formats](formats.md#videos); check that the calibration is of one of the two sizes.",
)
FIRST_PICTURE_MOVED = FILES.code(
    "first_picture_moved",
    _FINDING,
    "The file of a video states its first picture too early; it is taken a frame before the second one.",
    "Nothing is to be done; MP4 that is not fragmented states the right time.",
)
SOUND_DELAY_UNKNOWN = FILES.code(
    "sound_delay_unknown",
    _FINDING,
    "The file of a video does not state the delay of its AAC sound, which may be off by 21 ms or more.",
    "Nothing is to be done where motion measures the offsets; else send MP4 that is not fragmented.",
)
SHOWN_MIRRORED = FILES.code(
    "shown_mirrored",
    _FINDING,
    "The file of a video says that its picture is mirrored for display. It is read mirrored, like players show it.",
    "If the calibration is of the picture that is not mirrored, turn off the mirroring and export again.",
)
PICTURE_DARK = FILES.code(
    "picture_dark",
    _FINDING,
    "The picture of a camera is too dark.",
    "Light the scene, open the aperture or expose longer.",
)
PICTURE_BLURRED = FILES.code(
    "picture_blurred",
    _FINDING,
    "The picture of a camera is blurred.",
    "Focus on the place where people are; clean the lens; send the video as the camera recorded it.",
)
PICTURE_FROZEN = FILES.code(
    "picture_frozen",
    _FINDING,
    "The picture of a camera stays the same while another camera sees motion.",
    "Look at the video; export it again, or leave the camera out.",
)
PICTURES_LEFT_OUT = FILES.code(
    "pictures_left_out",
    _FINDING,
    "The service had no time or memory to look at all pictures.",
    "Send the session again when the service is less busy to have all pictures looked at.",
)
SESSION_WARNING = FILES.code(
    "session_warning", _FINDING, "A warning of a version that had sentences only.", "Read `message`."
)


PEOPLE = CodeGroup(
    "Findings about people",
    "Codes of findings of `multicap check`, and of warnings of a job, from the people whom the cameras see at twelve "
    "instants. Findings about the world have the codes of [warnings of a result](#warnings-of-a-result). Errors end "
    "the job (`session_refused`) and the command, unless it is forced.",
)

NOBODY_DETECTED = PEOPLE.code(
    "nobody_detected",
    _PEOPLE,
    "The detector found people in no camera, or in one alone.",
    "See that people are in the pictures, upright, bright and large enough.",
)
CAMERA_SEES_NOBODY = PEOPLE.code(
    "camera_sees_nobody",
    _PEOPLE,
    "The detector found nobody in a camera, and people in others.",
    "See that the camera looks at the people.",
)
CLOCKS_DISAGREE = PEOPLE.code(
    "clocks_disagree",
    _PEOPLE,
    "The declared times of a camera are wrong by more than half a frame.",
    "Synchronise by the people with `sync: auto`, or correct the offset.",
)
CLOCK_MEASURED = PEOPLE.code(
    "clock_measured",
    _FINDING,
    "`multicap check --sync auto` measured the offset of a camera.",
    "Reconstruct with `sync: auto`, or declare the offset.",
)
SAME_VIDEO = PEOPLE.code(
    "same_video", _ERROR, "Two cameras have the same video or keypoints.", "Give each camera its own video."
)
CAMERAS_EXCHANGED = PEOPLE.code(
    "cameras_exchanged",
    _ERROR,
    "The video of a camera fits the calibration of another camera.",
    "Exchange the videos, or the entries of the calibration.",
)
CAMERA_HANGS_TURNED = PEOPLE.code(
    "camera_hangs_turned",
    _PEOPLE,
    "A camera hangs on its side, upside down or askew: its pictures are turned upright before people are detected.",
    "Nothing, if the camera hangs so.",
)
PICTURE_TURNED = PEOPLE.code(
    "picture_turned",
    _ERROR,
    "The picture of a camera is turned against its calibration.",
    "Turn the video, or calibrate the camera as it is turned.",
)
PICTURE_MIRRORED = PEOPLE.code(
    "picture_mirrored",
    _ERROR,
    "The picture of a camera is mirrored against its calibration.",
    "Turn off the mirroring, or mirror the video back.",
)
COORDINATES_EXCHANGED = PEOPLE.code(
    "coordinates_exchanged", _ERROR, "x and y of a camera's keypoints are exchanged.", "Write x first, then y."
)
CALIBRATION_OF_ANOTHER_RIG = PEOPLE.code(
    "calibration_of_another_rig",
    _ERROR,
    "No two cameras agree about people.",
    "Give the calibration of these cameras; check the synchronisation.",
)
NO_COMMON_PEOPLE = PEOPLE.code(
    "no_common_people",
    _PEOPLE,
    "A camera sees people, and never at the same time as another camera.",
    "Check its offset, and where it looks.",
)


FINDINGS = CodeGroup(
    "Findings of checks",
    "`multicap calibration check FILE` lists what is wrong (`error`) or doubtful (`warning`) about a calibration. With "
    "videos or keypoints it lists failed checks of the people too, under the codes of warnings of a result.",
)

SAME_PLACE = FINDINGS.code(
    "same_place",
    _ERROR,
    "Two cameras are at the same place; an error if they are turned alike, too.",
    "Check whether one camera stands twice in the file.",
)
WORLD_UNIT = FINDINGS.code(
    "world_unit",
    ("422", *_ERROR),
    "The cameras are farther apart, or closer together, than those of any rig.",
    "State the unit of the calibration.",
)
UP_AXIS_UNKNOWN = FINDINGS.code(
    "up_axis_unknown",
    _FINDING,
    "The cameras do not tell which axis of the calibration points up, such as cameras that look straight down.",
    "State the axis (`up`, `--up`) if Z does not point up; `up_axes` of the evidence has those that may.",
)
NO_COMMON_VIEW = FINDINGS.code(
    "no_common_view",
    _ERROR,
    "No other camera sees any place that the camera sees; an error if that holds for all cameras.",
    "Check the pose of the camera, or turn it to the view of the others.",
)
FOCAL_LENGTH = FINDINGS.code(
    "focal_length",
    _FINDING,
    "The focal length does not fit the size of the picture.",
    "Check that the camera matrix belongs to this size, in pixels.",
)
PIXELS_NOT_SQUARE = FINDINGS.code(
    "pixels_not_square",
    _FINDING,
    "The focal lengths along x and y differ.",
    "Check the camera matrix, unless the picture was stretched.",
)
PRINCIPAL_POINT = FINDINGS.code(
    "principal_point",
    _FINDING,
    "The principal point is far from the middle of the picture.",
    "Check that the camera matrix belongs to this size, and that the picture was not cropped.",
)
DISTORTION_FOLDS = FINDINGS.code(
    "distortion_folds",
    _ERROR,
    "The distortion has no inverse in a part of the picture; an error if that part is not only in the corners.",
    "Calibrate the lens again with views near the edges, or with fewer coefficients.",
)
