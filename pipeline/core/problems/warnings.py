"""Codes of warnings of a result."""

from pipeline.core.problems.model import CodeGroup

_WARNING = ("warning",)
_WARNING_AND_FINDING = ("warning", "finding")
# Findings that may be errors, which refuse a session.
_ERROR = (*_WARNING_AND_FINDING, "job", "command")

WARNINGS = CodeGroup(
    "Warnings of a result",
    "Codes of `result_warnings` of a job, and of `capture_checks` and `world_checks` in `metrics.json`. The result "
    "files exist, but the capture or the calibration may be wrong.",
)

NOBODY_FOUND = WARNINGS.code(
    "nobody_found",
    _WARNING_AND_FINDING,
    "No person was found.",
    "Check that the calibration belongs to the videos, and that two cameras see a person at the same time.",
)
EVERYBODY_REMOVED = WARNINGS.code(
    "everybody_removed",
    _WARNING,
    "Edits removed everybody who was found.",
    "Undo an edit: `PATCH /v1/jobs/{id}/people` with the list without it.",
)
TAKE_TOO_LARGE = WARNINGS.code(
    "take_too_large",
    _WARNING,
    "A file with the whole take would be larger than its format allows; the files of the people are there.",
    "Ask for fewer frames by `frame_range`, or for a lower `output_rate_hz`.",
)
OPENSIM_FAILED = WARNINGS.code(
    "opensim_failed",
    _WARNING,
    "OpenSim could not scale its model to a person, or not follow the person's markers; the message says why.",
    "See [OpenSim](biomechanics.md#opensim). The person's archive has the setups to run it by hand.",
)
TOO_FEW_CAMERAS = WARNINGS.code(
    "too_few_cameras", ("422", *_ERROR), "The session has fewer than three cameras.", "Add a camera."
)
DAMAGED_VIDEO = WARNINGS.code(
    "damaged_video",
    _WARNING,
    "Videos have damaged or missing frames.",
    "Copy the files again; see [formats](formats.md#videos).",
)
FRAMES_DOUBLED = WARNINGS.code(
    "frames_doubled",
    _WARNING,
    "Frames of a video show the picture before once more: people lag behind there.",
    "Record with a camera that keeps its rate, or export without a constant rate.",
)
CAMERA_WITHOUT_PEOPLE = WARNINGS.code(
    "camera_without_people",
    _WARNING_AND_FINDING,
    "A camera was matched with no person.",
    "Check its video, its calibration and its offset.",
)
FEW_VIEWS = WARNINGS.code(
    "few_views", _WARNING, "Fewer than three cameras saw a person in most frames.", "Add or move cameras."
)
APPROXIMATE_ASSOCIATION = WARNINGS.code(
    "approximate_association",
    _WARNING,
    "Some frames show more people than exact methods can tell apart.",
    "Check these frames; see [tracking](tracking.md#crowds) and [clustering](clustering.md#crowds).",
)
UNCERTAIN_IDENTITY = WARNINGS.code(
    "uncertain_identity",
    _WARNING,
    "Two people may have been taken for each other at some moment.",
    "Look at the moments under `identity.doubts` in metrics.json; see [who is who](identity.md#doubts).",
)
PERSON_LOST = WARNINGS.code(
    "person_lost",
    _WARNING,
    "A person vanishes in the middle of the room: cameras view the place, and the person is not found there.",
    "Look at the frames and the place in the message; add cameras, or try the other `method`. See "
    "[losses](identity.md#losses).",
)
PHANTOM_ENDED = WARNINGS.code(
    "phantom_ended",
    _WARNING,
    "A track was made of the limbs of other people for some time; these frames were taken from it.",
    "Look at the frames in the message: a person may have been there. See [losses](identity.md#losses).",
)
LIMB_MISMEASURED = WARNINGS.code(
    "limb_mismeasured",
    _WARNING,
    "A limb was located with a length that the person's other side or proportions exclude. The fit uses another one.",
    "Look at this limb: it may be hidden for most of the take. See [the fit](fit.md#skeleton-fitpy-articulatedpy).",
)
PERSON_NEVER_MOVES = WARNINGS.code(
    "person_never_moves",
    _WARNING,
    "A person never moves: a poster, a mannequin, or somebody who sleeps.",
    "Remove the picture if it is one (`PATCH /v1/jobs/{id}/people`); see [likenesses](identity.md#likenesses).",
)
MIRROR_IMAGE = WARNINGS.code(
    "mirror_image",
    _WARNING,
    "A person is the mirror image of another one.",
    "Remove the image (`PATCH /v1/jobs/{id}/people`), or cover the mirror; see [likenesses](identity.md#likenesses).",
)
CALIBRATION_REFINED = WARNINGS.code(
    "calibration_refined",
    _WARNING,
    "Cameras were moved to fit the people of the take.",
    "Use the result calibration.json for other takes; see [refinement](calibration.md#refinement).",
)
CALIBRATION_KEPT = WARNINGS.code(
    "calibration_kept",
    _WARNING,
    "`refine_calibration` is `auto`, and the given calibration was kept: it fits about as well, or the people do not "
    "determine the cameras. Its severity is `info`.",
    "Nothing if the calibration fits. Otherwise let people walk all over the place; see "
    "[refinement](calibration.md#refinement).",
)
WORLD_LEVELED = WARNINGS.code(
    "world_leveled",
    _WARNING,
    "The floor was tilted or not at z = 0, and the world was moved so that feet stand at z = 0.",
    "Use the result calibration.json for other takes; see [refinement](calibration.md#refinement).",
)
CAMERA_BUMPED = WARNINGS.code(
    "camera_bumped",
    _WARNING,
    "A camera was moved during the take.",
    "Reconstruct the frames before and after the time in the message on their own (`frame_range`).",
)
SYNC_BY_SOUND = WARNINGS.code(
    "sync_by_sound",
    _WARNING,
    "The offsets of the cameras are those of their sound alone.",
    "Look at the motion; declare the offset, or film people who move where all cameras see them.",
)
SYNC_AS_DECLARED = WARNINGS.code(
    "sync_as_declared",
    _WARNING,
    "The offsets of the cameras are the declared ones, whose uncertainty is stated: motion does not tell them.",
    "Look at the motion; film people who move where all cameras see them.",
)
SYNC_BEYOND_DECLARED = WARNINGS.code(
    "sync_beyond_declared",
    _WARNING,
    "The measured offset of a camera is beyond the uncertainty of the declared one.",
    "Look at the motion; the clock of the camera was wrong, or its pictures came late.",
)
SYNC_UNCERTAIN = WARNINGS.code(
    "sync_uncertain",
    _WARNING,
    "The measured clock of a camera may be wrong by up to half a frame.",
    "Look at the motion; declare the offset, or film people who move where all cameras see them.",
)
PEOPLE_FEW_VIEWS = WARNINGS.code(
    "people_few_views",
    _WARNING,
    "A camera shares people with another camera briefly.",
    "Let people walk where it and a neighbour see them.",
)
PEOPLE_POOR_FIT = WARNINGS.code(
    "people_poor_fit",
    _WARNING,
    "People fit a camera worse than the other cameras.",
    "Check its synchronisation, whether it moved, and its intrinsics.",
)
PEOPLE_SAME_PLACE = WARNINGS.code(
    "people_same_place",
    _WARNING,
    "Two cameras come out at nearly the same place.",
    "Check whether one video was given twice.",
)
PEOPLE_UNCERTAIN_POSE = WARNINGS.code(
    "people_uncertain_pose",
    _WARNING,
    "People determine the pose of a camera poorly.",
    "Film longer, with people all over the place.",
)
PEOPLE_UNCERTAIN_FOCAL = WARNINGS.code(
    "people_uncertain_focal",
    _WARNING,
    "People determine the focal length of a camera poorly.",
    "Give the intrinsics, or calibrate them from a board.",
)
PEOPLE_STATURES = WARNINGS.code(
    "people_statures",
    _WARNING,
    "The stated statures are not those of the people, in number or in their ratios.",
    "State the stature of each person, or one for all.",
)
PEOPLE_UNCERTAIN_FLOOR = WARNINGS.code(
    "people_uncertain_floor",
    _WARNING,
    "The feet reach too little ground to find its slope.",
    "Let people walk all over the place.",
)
BOARD_FEW_VIEWS = WARNINGS.code(
    "board_few_views",
    _WARNING,
    "The board was found in few pictures of a camera.",
    "Film it longer, at several distances and tilts.",
)
BOARD_POOR_COVERAGE = WARNINGS.code(
    "board_poor_coverage",
    _WARNING,
    "The board covers a small part of a camera's picture.",
    "Film it near the edges and corners too; see the picture `coverage_CAMERA.svg`.",
)
BOARD_MIRRORED = WARNINGS.code(
    "board_mirrored",
    _WARNING,
    "The board is mirrored in some pictures.",
    "Turn off the mirroring of the camera: its videos are mirrored too.",
)
BOARD_AMBIGUOUS = WARNINGS.code(
    "board_ambiguous",
    _WARNING,
    "The chessboard looks the same after half a turn, so that the world may be turned by half a turn.",
    "Use a board with an odd and an even number, a ChArUco board, or known points.",
)
BOARD_FEW_SHARED = WARNINGS.code(
    "board_few_shared",
    _WARNING,
    "A camera is linked to the others by few views of the board.",
    "Film the board where the camera and a neighbour both see it.",
)
BOARD_DISAGREES = WARNINGS.code(
    "board_disagrees",
    _WARNING,
    "Cameras see the board at poses that differ by much more than their own errors: they are not synchronous, their "
    "shutters roll, the board is bent, or a lens is wrong.",
    "`hint` has the likely cause: a delay to state, or what to film again. Lenses rest on each camera's own views.",
)
BOARD_FLOOR_UNCERTAIN = WARNINGS.code(
    "board_floor_uncertain",
    _WARNING,
    "The board never lies still on the floor, so that the floor of the world is a guess.",
    "Lay it flat on the floor for a second, or state the time (`--floor-time`).",
)
KNOWN_POINTS_DOUBTFUL = WARNINGS.code(
    "known_points_doubtful",
    _WARNING,
    "A known point is far from where the cameras see it, or all cameras are below the points.",
    "Check its coordinates and its marked pixels, and that Z points up.",
)
UPSIDE_DOWN = WARNINGS.code(
    "upside_down",
    _ERROR,
    "Heads are below feet.",
    "Turn the calibration: state by `up` which axis points up.",
)
NOT_UPRIGHT = WARNINGS.code(
    "not_upright",
    _ERROR,
    "People lean in most frames.",
    "Check which axis points up; state it by `up` if it is not Z.",
)
FLOOR_NOT_AT_ZERO = WARNINGS.code(
    "floor_not_at_zero", _WARNING_AND_FINDING, "Feet do not stand at a height of 0.", "Move the calibration's origin."
)
FLOOR_TILTED = WARNINGS.code(
    "floor_tilted", _WARNING_AND_FINDING, "The floor that feet stand on is tilted.", "Level the calibration."
)
STATURE_OUT_OF_RANGE = WARNINGS.code(
    "stature_out_of_range", _ERROR, "A person is not 1.0 to 2.3 m tall.", "Check the calibration's unit."
)
CAMERA_BELOW_FLOOR = WARNINGS.code(
    "camera_below_floor", _WARNING_AND_FINDING, "A camera is below the floor.", "Check the calibration's axes."
)
MIRRORED_WORLD = WARNINGS.code(
    "mirrored_world",
    _ERROR,
    "People's left and right are exchanged.",
    "Check the signs of the calibration's axes, and that the videos are not mirrored.",
)
CAMERA_DISAGREES = WARNINGS.code(
    "camera_disagrees",
    _ERROR,
    "A camera sees people elsewhere than the other cameras do.",
    "Refine the calibration; see [refinement](calibration.md#refinement). Or check the camera's offset.",
)
