"""Problem codes of the files that users send: calibrations, videos, keypoints, times of frames, characters."""

from pipeline.core.problems.code_group import CodeGroup

CALIBRATIONS = CodeGroup("Calibration", "Formats and limits are in [formats](formats.md#calibration).")

CALIBRATION_MISSING = CALIBRATIONS.code("calibration_missing", 422, "command")
"""There is no such file. | Check the path."""
CALIBRATION_UNREADABLE = CALIBRATIONS.code("calibration_unreadable", 422, "command")
"""The file is damaged or not of its format. | Export it again."""
CALIBRATION_FORMAT = CALIBRATIONS.code("calibration_format", 422, "command")
"""The format is not known. | Use one of the [formats](formats.md#calibration)."""
CALIBRATION_TOO_LARGE = CALIBRATIONS.code("calibration_too_large", 422, "command")
"""The file is larger than a calibration may be. | Check that it is a calibration."""
CALIBRATION_EMPTY = CALIBRATIONS.code("calibration_empty", 422, "command")
"""The calibration has no camera. | Export it with its cameras."""
CALIBRATION_UNITS = CALIBRATIONS.code("calibration_units", 422, "command")
"""The format states its own unit of length; `units` contradicts it. | Omit `units`."""
CALIBRATION_UNITS_UNSTATED = CALIBRATIONS.code("calibration_units_unstated", 422, "command")
"""Neither the file nor `units` states the unit of length, and metres are not plausible. | State `units`; `message` has
the distances of a camera in both units."""
BOARD_INVALID = CALIBRATIONS.code("board_invalid", 422, "command")
"""The specification of a board is malformed or not plausible. | Write it as
[calibration](../guide/calibration.md#from-a-board) says."""
BOARD_NOT_FOUND = CALIBRATIONS.code("board_not_found", "job", "command")
"""The board was found in too few pictures of a camera. | Check the numbers of the board; film it sharp and whole."""
BOARD_EXCHANGED = CALIBRATIONS.code("board_exchanged", "job", "command")
"""The numbers of columns and rows of the board are exchanged. | State the board as `hint` says."""
BOARD_UNLINKED = CALIBRATIONS.code("board_unlinked", "job", "command")
"""A camera shares too few views of the board with the others. | Film the board where the camera and a neighbour both
see it."""
KNOWN_POINTS_INVALID = CALIBRATIONS.code("known_points_invalid", 422, "job", "command")
"""A known point is malformed, is named twice, or is not in the picture. | Correct it as
[calibration](../guide/calibration.md#known-points) says."""
KNOWN_POINTS_FEW = CALIBRATIONS.code("known_points_few", 422, "job", "command")
"""Fewer than three known points are seen by two cameras, or too few by a camera of a scene. | Mark each point in the
pictures of two cameras or more, under the same name; of a scene, four in each picture, or six."""
KNOWN_POINTS_ON_A_LINE = CALIBRATIONS.code("known_points_on_a_line", 422, "job", "command")
"""The known points are on a line, about which the world or a camera could turn. | Add a point beside the line."""
KNOWN_POINTS_MISFIT = CALIBRATIONS.code("known_points_misfit", 422, "job", "command")
"""The known points don't fit to where the cameras see them: a wrong unit, mirrored axes, or a wrong point. | `hint` has
the reason if it was found."""
PEOPLE_ONE_CAMERA = CALIBRATIONS.code("people_one_camera", 422, "command")
"""People calibrate two cameras or more. | Film a board to calibrate one camera."""
PEOPLE_NOT_FOUND = CALIBRATIONS.code("people_not_found", 422, "command")
"""A camera sees people too briefly to be calibrated from them. | Let people walk about for a minute where several
cameras see them whole."""
PEOPLE_UNLINKED = CALIBRATIONS.code("people_unlinked", 422, "command")
"""A camera sees no person at the same time as another camera, or can't tell who it is. | Let one or two people walk
where several cameras see them."""
PEOPLE_DISAGREE = CALIBRATIONS.code("people_disagree", 422, "command")
"""A camera's view of the people contradicts the other cameras. | Check the synchronisation, that no camera moved,
and the intrinsics."""
PEOPLE_NOT_WHOLE = CALIBRATIONS.code("people_not_whole", 422, "command")
"""No person is seen from the shoulders to the ankles, so scale and vertical are unknown. | Film people whole."""
BOARD_UNSYNCHRONISED = CALIBRATIONS.code("board_unsynchronised", "job", "command")
"""Two cameras see the board at poses that contradict each other. | Synchronise the videos; `hint` has the offset if one
was found."""
IMAGES_MISSING = CALIBRATIONS.code("images_missing", "command")
"""The folder has no photographs. | Check the path."""
IMAGE_UNREADABLE = CALIBRATIONS.code("image_unreadable", "command")
"""A photograph can't be read. | Leave it out."""
IMAGE_SIZE = CALIBRATIONS.code("image_size", "command")
"""Photographs of a camera differ in size. | Leave some out."""
CAMERA_UNKNOWN = CALIBRATIONS.code("camera_unknown", "command")
"""The calibration has no camera of this name. | Name the folders of the photographs, or the camera of the option, as
the calibration does."""
UNKNOWN_VERSION = CALIBRATIONS.code("unknown_version", 422, "command")
"""`schema_version` is not supported. | Write version 1."""
TOO_MANY_CAMERAS = CALIBRATIONS.code("too_many_cameras", 422, "command")
"""The calibration has more cameras than allowed. | Remove some."""
DUPLICATE_CAMERA = CALIBRATIONS.code("duplicate_camera", 422, "command")
"""Two cameras have the same name. | Rename one."""
INVALID_NAME = CALIBRATIONS.code("invalid_name", 422, "command")
"""A camera has no usable name. | Name the camera."""
INVALID_SIZE = CALIBRATIONS.code("invalid_size", 422, "command")
"""The image size is not two whole numbers within the limits. | Correct it."""
INVALID_MATRIX = CALIBRATIONS.code("invalid_matrix", 422, "command")
"""The camera matrix is malformed or not plausible. | Calibrate again."""
INVALID_DISTORTION = CALIBRATIONS.code("invalid_distortion", 422, "command")
"""Distortion does not have 0, 4, 5, 8, 12 or 14 plausible coefficients. | Correct them."""
INVALID_ROTATION = CALIBRATIONS.code("invalid_rotation", 422, "command")
"""The rotation is not a rotation. | Correct it, or calibrate again."""
INVALID_TRANSLATION = CALIBRATIONS.code("invalid_translation", 422, "command")
"""The translation is not three plausible numbers. | Correct it or its unit."""
INVALID_NUMBER = CALIBRATIONS.code("invalid_number", 422, "command")
"""An attribute of the QCA file is missing or no number. | Export it again."""
UNSUPPORTED_LENS = CALIBRATIONS.code("unsupported_lens", 422, "command")
"""The lens model is none of OpenCV's standard and fisheye models, has a tilted sensor, or a field that may hold the
distortion has a name that is not read. | Undistort the videos, or calibrate with the standard or the fisheye model;
name the field as the format does."""

VIDEOS = CodeGroup("Videos and cameras", "Formats and limits are in [formats](formats.md#videos).")

IMAGES_ARCHIVE = VIDEOS.code("images_archive", 422, "command")
"""An archive of images is damaged, too large, or not of one camera. | Send a zip of the images of each camera; see
[formats](formats.md#images)."""
NO_IMAGES = VIDEOS.code("no_images", 422, "command")
"""A folder or an archive has no images. | Send JPEG, PNG, BMP or TIFF."""
NO_FRAME_RATE = VIDEOS.code("no_frame_rate", 422, "command")
"""Images, or keypoints without timestamps, have no frame rate. | State it: `frame_rate_hz`, `--frame-rate`, a camera's
`rate`; or give timestamps of keypoints."""
TOO_FEW_VIDEOS = VIDEOS.code("too_few_videos", 422, "command")
"""There are fewer than two videos. | Give one video of each camera."""
DUPLICATE_VIDEO = VIDEOS.code("duplicate_video", 422, "command")
"""Two videos have the same name except for the suffix. | Rename one."""
PAIRING_UNKNOWN = VIDEOS.code("pairing_unknown", 422, "command")
"""No video or folder has the name of a camera as a whole word in its name. | Name them alike, state the file of each
camera, or ask for pairing by order: `pair_by_order`, `--pair-by-order`."""
PAIRING_AMBIGUOUS = VIDEOS.code("pairing_ambiguous", 422, "command")
"""The name of a video or folder has the names of several cameras. | Rename it, or state the file of each camera."""
PAIRING_COUNTS = VIDEOS.code("pairing_counts", 422, "command")
"""Videos or folders are to be paired with cameras by order, and there are not as many. | Name them as the cameras, or
leave out what is too much."""
PARTS_DIFFER = VIDEOS.code("parts_differ", 422, "command")
"""Files that are to be the parts of one recording differ in size, rotation, codec or frame rate. | Give each camera the
files of one recording, as the camera wrote them."""
PARTS_GAP = VIDEOS.code("parts_gap", 422, "command")
"""A part of a recording is missing, by the numbers or the clocks of its files. | Add the part, or send one part
alone."""
VIDEO_WITHOUT_CAMERA = VIDEOS.code("video_without_camera", 422, "command")
"""No camera's name is a whole word in the video's name, while other videos have cameras' names. | Rename the video, or
state its camera."""
CAMERA_WITHOUT_VIDEO = VIDEOS.code("camera_without_video", 422, "command")
"""No video has the name of this camera, and it can't be left out: the manifest names it, a video has no camera, or
fewer than two cameras have a video. | Add the video, or remove the camera from the calibration."""
CAMERA_WITH_TWO_VIDEOS = VIDEOS.code("camera_with_two_videos", 422, "command")
"""Two videos belong to one camera by their names or by the manifest. | Remove one video, or name its camera in the
manifest."""
RECORDING_CAMERA_UNKNOWN = VIDEOS.code("recording_camera_unknown", 422, "command")
"""The manifest, or a stated folder, names an unknown camera. | Correct the name."""
DUPLICATE_RECORDING = VIDEOS.code("duplicate_recording", 422, "command")
"""The manifest names a camera twice. | Name each camera once."""
RECORDING_FILE_UNKNOWN = VIDEOS.code("recording_file_unknown", 422, "command")
"""The manifest names an unknown video or archive of keypoints. | Correct the name."""
DUPLICATE_RECORDING_FILE = VIDEOS.code("duplicate_recording_file", 422, "command")
"""The manifest gives one video, or one archive of keypoints, to two cameras. | Give each camera its own."""
SIZE_MISMATCH = VIDEOS.code("size_mismatch", 422, "command")
"""The video and its calibration have different sizes in pixels, and neither a codec's padding, nor a scale, nor the
rotation in the video file explains the difference. | Calibrate at the size of the videos."""
VIDEO_MISSING = VIDEOS.code("video_missing", 422, "command")
"""There is no such file. | Check the path."""
VIDEO_EMPTY = VIDEOS.code("video_empty", 422, "command")
"""The file has no bytes. | Copy it again."""
VIDEO_UNREADABLE = VIDEOS.code("video_unreadable", 422, "job", "command")
"""The file is not a readable video, or decoding exceeded the limits on time or memory. | Convert it to H.264 in MP4;
record or export it again if its index is missing."""
NO_VIDEO_STREAM = VIDEOS.code("no_video_stream", 422, "command")
"""The file has no video stream that can be decoded. | Check the file."""
UNSUPPORTED_CODEC = VIDEOS.code("unsupported_codec", 422, "command")
"""The codec is not supported. | Convert the video, for example to H.264."""
NO_FRAMES = VIDEOS.code("no_frames", 422, "command")
"""The video has no frame that can be decoded. | Record or export it again."""
NO_KEYFRAMES = VIDEOS.code("no_keyframes", 422, "command")
"""The video has no keyframe. | Convert it again."""
VIDEO_TOO_LARGE = VIDEOS.code("video_too_large", 422, "command")
"""The frames have too many pixels. | Scale the video down."""
VIDEO_TOO_LONG = VIDEOS.code("video_too_long", 422, "command")
"""The video has too many frames. | Cut the video."""
VIDEO_TRUNCATED = VIDEOS.code("video_truncated", 422, "command")
"""The file ends before its last frame. | Copy it again."""
VIDEO_CHANGES_SIZE = VIDEOS.code("video_changes_size", 422, "job", "command")
"""The size of the frames changes within the video. | Cut the video there."""
VIDEO_TIMES = VIDEOS.code("video_times", 422, "job", "command")
"""Times of frames are missing, go back, or repeat in more than 10 % of the frames. | Convert the video, for example to
MP4."""
VIDEO_DAMAGED = VIDEOS.code("video_damaged", "job", "command")
"""Frames can't be decoded, or more than 10 % of the used frames are damaged. | Copy the file again, or cut the damaged
part away."""

KEYPOINTS = CodeGroup("Keypoints", "Formats and limits are in [formats](formats.md#keypoints).")

KEYPOINTS_ARCHIVE = KEYPOINTS.code("keypoints_archive", 422, "command")
"""The archive is damaged or not allowed. | Send a zip of the files of keypoints of each camera."""
KEYPOINTS_MISSING = KEYPOINTS.code("keypoints_missing", 422, "command")
"""There is no such folder. | Check the path."""
TOO_FEW_FOLDERS = KEYPOINTS.code("too_few_folders", 422, "command")
"""There are fewer than two folders. | Give a folder for each camera."""
FOLDER_WITHOUT_CAMERA = KEYPOINTS.code("folder_without_camera", 422, "command")
"""No camera's name is a whole word in the folder's name, while other folders have cameras' names. | Rename the
folder."""
CAMERA_WITHOUT_FOLDER = KEYPOINTS.code("camera_without_folder", 422, "command")
"""No folder has the name of this camera, and the camera can't be left out: a folder has no camera, or fewer than two
cameras have a folder. | Add the folder, or remove the camera from the calibration."""
CAMERA_WITH_TWO_FOLDERS = KEYPOINTS.code("camera_with_two_folders", 422, "command")
"""Two folders belong to one camera. | Remove one of them."""
KEYPOINTS_NONE = KEYPOINTS.code("keypoints_none", 422, "command")
"""The folder has no keypoint file, several files of all frames, or files of two forms. | Name the files
`..._000000000123_keypoints.json`, or provide one file of all frames."""
DUPLICATE_KEYPOINTS = KEYPOINTS.code("duplicate_keypoints", 422, "command")
"""Two files have the same frame number. | Remove one of them."""
KEYPOINTS_UNREADABLE = KEYPOINTS.code("keypoints_unreadable", 422, "command")
"""A file is not a keypoint file of a known format, or a frame or field of it can't be used. | Write the file again, or
remove it: a missing file is a dropped frame."""
KEYPOINTS_MIXED = KEYPOINTS.code("keypoints_mixed", 422, "command")
"""The files have different numbers of joints. | Use one set of joints for all files."""
KEYPOINTS_LAYOUT = KEYPOINTS.code("keypoints_layout", 422, "command")
"""Several layouts have as many points as a person, and the people do not tell which one it is. | State the layout of
the points: `--layout`, `layout` of the manifest."""
OWN_POINTS_INVALID = KEYPOINTS.code("own_points_invalid", 422, "command")
"""The file about your own points can't be used: unknown points, or distances that contradict each other or fix no
shape. | Follow the message."""
KEYPOINTS_EMPTY = KEYPOINTS.code("keypoints_empty", 422, "command")
"""No file has a person. | Check the detector's output."""
KEYPOINTS_SCORES = KEYPOINTS.code("keypoints_scores", 422, "command")
"""The scale of a camera's scores is unknown. | Write scores from 0 to 1, percent, 0 to 255, or logits."""
TOO_MANY_PEOPLE = KEYPOINTS.code("too_many_people", 422, "command")
"""A frame has too many people. | Omit the people with low scores."""

TIMES = CodeGroup("Times of frames", "Limits are in [formats](formats.md#limits-of-the-clock).")

FRAME_RATE = TIMES.code("frame_rate", 422, "command")
"""A frame rate is too low or too high. | State the true frame rate."""
OFFSET_RANGE = TIMES.code("offset_range", 422, "command")
"""An offset is too far from the start of the capture. | Count from the start of the capture."""
NO_TIMECODE = TIMES.code("no_timecode", 422, "command")
"""`clock` is `timecode`, but a video has none. | State offsets instead."""
NO_CREATION_TIME = TIMES.code("no_creation_time", 422, "command")
"""`clock` is `creation_time`, but a video states none. | State offsets instead."""
NO_OVERLAP = TIMES.code("no_overlap", 422, "command")
"""The camera recorded while no other camera did. | Check offsets and timestamps."""
SESSION_TOO_LONG = TIMES.code("session_too_long", 422, "command")
"""A camera or the session lasts longer than Multicap or the operator allows. | Check the times, or cut the session into
several."""
TOO_MANY_FRAMES = TIMES.code("too_many_frames", 422, "command")
"""The session has too many output frames. | Use a lower output rate or fewer frames."""
TWO_CLOCKS = TIMES.code("two_clocks", 422, "command")
"""Both timestamps and a frame rate were given. | Give one of them."""
TIMESTAMPS_INVALID = TIMES.code("timestamps_invalid", 422, "command")
"""The timestamps can't be read, or a row is wrong. | Correct the CSV."""
TIMESTAMPS_MISSING = TIMES.code("timestamps_missing", 422, "command")
"""Frames of a camera have no time. | Add rows for these frames."""
TIMESTAMPS_ORDER = TIMES.code("timestamps_order", 422, "command")
"""Times do not ascend from frame to frame. | Correct the times."""
TIMESTAMPS_START = TIMES.code("timestamps_start", 422, "command")
"""The times do not count from the start of the capture. | Subtract the first time."""

LABORATORY_UNREADABLE = TIMES.code("laboratory_unreadable", 422, "command")
"""The C3D file of a laboratory is damaged, or has no analog channels. | Follow the message; export the file again."""
LABORATORY_CLOCK = TIMES.code("laboratory_clock", 422, "command")
"""The C3D file of a laboratory, or the videos, lack the clock that was asked for. | State another clock, or the channel
of the trigger."""

CHARACTERS = CodeGroup(
    "Characters",
    "Characters of the user's own, onto which motion is retargeted; see [characters](../start/own-character.md).",
)

CHARACTER_FORMAT = CHARACTERS.code("character_format", 422, "command")
"""The file is in a format that characters are not read from. | Export the character as GLB (binary glTF 2.0), VRM or
binary FBX 7."""
CHARACTER_UNREADABLE = CHARACTERS.code("character_unreadable", 422, "command")
"""The file of the character is damaged, or breaks the rules of its format. | Follow the message: export the character
once more, as GLB with everything inside, or as binary FBX."""
CHARACTER_TOO_LARGE = CHARACTERS.code("character_too_large", 422, "command")
"""The file of the character is larger, or has more nodes or vertices, than is read. | Follow the message: leave out
what is not the character, or use smaller pictures."""
CHARACTER_BONES = CHARACTERS.code("character_bones", 422, "command")
"""Bones of the character are missing, or can't be turned. | Follow the message, or state the bones by a table of
bones."""
BONES_INVALID = CHARACTERS.code("bones_invalid", 422, "command")
"""The table of bones can't be used. | Correct it: each joint of the skeleton names a bone of the character, or null."""
