"""Problem codes of work: failed jobs, findings of checks, warnings of a result, and the command line."""

from pipeline.core.problems.code_group import CodeGroup

FILES = CodeGroup(
    "Findings about files",
    "Codes of `preflight.findings` of a session and of `multicap check`, from the files alone. None refuses a "
    "session; [findings](../lab/findings.md) lists the evidence of each. Findings about the cameras have the "
    "codes of [findings about calibrations](#findings-of-checks).",
)

FILE_IGNORED = FILES.code("file_ignored", "finding")
"""A file is not part of the session. | Remove it, or name it as needed."""
PAIRED_IN_SORTED_ORDER = FILES.code("paired_in_sorted_order", "finding")
"""Videos or folders were paired with cameras by the natural order of their names, as it was asked for. | Check the
pairs; give the files the names of the cameras."""
PARTS_JOINED = FILES.code("parts_joined", "finding")
"""Files are joined as the parts of one camera's recording. | Check that they are; state the file of the camera if they
are not."""
CAMERA_LEFT_OUT = FILES.code("camera_left_out", "finding")
"""Cameras of the calibration have no video or folder. | Add what is missing."""
CALIBRATION_NOTE = FILES.code("calibration_note", "finding")
"""Something was assumed about the calibration. | Check that it holds."""
CALIBRATION_ADAPTED = FILES.code("calibration_adapted", "finding")
"""The video has another size than its calibration, which was adapted. | Calibrate at the size of the videos if the
guess is wrong."""
FRAMES_REPEATED = FILES.code("frames_repeated", "finding")
"""Frames of a video have the timestamp of another frame. | Export the video again at a constant frame rate."""
KEYPOINTS_FORM = FILES.code("keypoints_form", "finding")
"""Keypoint files of another program than OpenPose were recognised by their content. | Check that they are of this
program."""
KEYPOINTS_SCALE = FILES.code("keypoints_scale", "finding")
"""Scores of keypoints are not from 0 to 1, or positions are not pixels of the picture, by all values of a camera. |
Check the scale that `message` names."""
CAMERA_SAW_NOBODY = FILES.code("camera_saw_nobody", "finding")
"""Keypoints of a camera show no person. | Check the detector's output."""
FRAMES_DROPPED = FILES.code("frames_dropped", "finding")
"""Frames of a video are missing: its times have gaps. Of keypoints: the numbers of the frames do. | Nothing is to be
done for slow motion; else record with a camera that keeps its rate."""
FRAMES_TOO_CLOSE = FILES.code("frames_too_close", "finding")
"""Frames of a video follow the one before at once. | Check what wrote the times of the video."""
FRAME_RATE_VARIES = FILES.code("frame_rate_varies", "finding")
"""The frame rate of a video varies. | Record at a constant rate for fast motion."""
SLOW_MOTION = FILES.code("slow_motion", "finding")
"""A video is a whole number of times as long as the others: it seems to be slow motion. | State the rate at which its
camera filmed (`rate`, `--rate`), unless the camera only ran longer."""
COARSE_CLOCK = FILES.code("coarse_clock", "finding")
"""The clock of the videos' starts is coarser than their frames. | State offsets, or synchronise by the people."""
LABORATORY_READ = FILES.code("laboratory_read", "finding")
"""A laboratory's C3D file was read; the message says what tells its time. | State the clock if the guess is wrong."""
INTERLACED_VIDEO = FILES.code("interlaced_video", "finding")
"""A video is interlaced: each picture shows two instants. | Record progressively, or deinterlace the video before."""
PIXEL_ASPECT = FILES.code("pixel_aspect", "finding")
"""The pixels of a video are not square; its pictures are scaled. | See [formats](formats.md#videos); check that the
calibration is of one of the two sizes."""
FIRST_PICTURE_MOVED = FILES.code("first_picture_moved", "finding")
"""The file of a video states its first picture too early; it is taken a frame before the second one. | Nothing is to be
done; MP4 that is not fragmented states the right time."""
SOUND_DELAY_UNKNOWN = FILES.code("sound_delay_unknown", "finding")
"""The file of a video does not state the delay of its AAC sound, which may be off by 21 ms or more. | Nothing is to be
done where motion measures the offsets; else send MP4 that is not fragmented."""
SHOWN_MIRRORED = FILES.code("shown_mirrored", "finding")
"""The file of a video says that its picture is mirrored for display. It is read mirrored, like players show it. | If
the calibration is of the picture that is not mirrored, turn off the mirroring and export again."""
PICTURE_DARK = FILES.code("picture_dark", "finding")
"""The picture of a camera is too dark. | Light the scene, open the aperture or expose longer."""
PICTURE_BLURRED = FILES.code("picture_blurred", "finding")
"""The picture of a camera is blurred. | Focus on the place where people are; clean the lens; send the video as the
camera recorded it."""
PICTURE_FROZEN = FILES.code("picture_frozen", "finding")
"""The picture of a camera stays the same while another camera sees motion. | Look at the video; export it again, or
leave the camera out."""
PICTURES_LEFT_OUT = FILES.code("pictures_left_out", "finding")
"""The service had no time or memory to look at all pictures. | Send the capture again when the service is less busy to
have all pictures looked at."""
CLIP_NOT_SENT = FILES.code("clip_not_sent", "finding")
"""A phone has sent no clip of a take, which is made without it. | Ask the phone for its clip, then make the session
again."""
CLIP_OUTSIDE_TAKE = FILES.code("clip_outside_take", "finding")
"""The first frame of a phone's clip is not within the take. | Check the clock of the phone."""
CLIP_PART_LEFT_OUT = FILES.code("clip_part_left_out", "finding")
"""A phone's clip has several parts, of which the longest is used. | Record the take again if a missing part matters."""

PEOPLE = CodeGroup(
    "Findings about people",
    "Codes of findings of `multicap check`, and of warnings of a job, from people in view at "
    "twelve instants. Findings about the world have the codes of [warnings of a result](#warnings-of-a-result). "
    "Errors end the job (`session_refused`) and the command, unless it is forced.",
)

NOBODY_DETECTED = PEOPLE.code("nobody_detected", "finding", "warning")
"""The detector found people in no camera, or in one alone. | See that people are in the pictures, upright, bright and
large enough."""
CAMERA_SEES_NOBODY = PEOPLE.code("camera_sees_nobody", "finding", "warning")
"""The detector found no person in a camera, and people in others. | See that the camera looks at the people."""
CLOCKS_DISAGREE = PEOPLE.code("clocks_disagree", "finding", "warning")
"""The declared times of a camera are wrong by more than half a frame. | Synchronise by the people with `sync: auto`, or
correct the offset."""
CLOCKS_UNCHECKED = PEOPLE.code("clocks_unchecked", "finding")
"""The declared times of the cameras were not compared, since too many people are in view. | Synchronise by the people
with `sync: auto`, or check a part of the take with fewer people."""
CLOCK_MEASURED = PEOPLE.code("clock_measured", "finding")
"""`multicap check --sync auto` measured the offset of a camera. | Reconstruct with `sync: auto`, or declare the
offset."""
SAME_VIDEO = PEOPLE.code("same_video", "finding", "warning", "job", "command")
"""Two cameras have the same video or keypoints. | Give each camera its own video."""
CAMERAS_EXCHANGED = PEOPLE.code("cameras_exchanged", "finding", "warning", "job", "command")
"""The video of a camera fits the calibration of another camera. | Exchange the videos, or the entries of the
calibration."""
CAMERA_HANGS_TURNED = PEOPLE.code("camera_hangs_turned", "finding", "warning")
"""A camera hangs on its side, upside down or askew: its pictures are turned upright before people are detected. |
Nothing, if the camera hangs so."""
PICTURE_TURNED = PEOPLE.code("picture_turned", "finding", "warning", "job", "command")
"""The picture of a camera is turned against its calibration. | Turn the video, or calibrate the camera as it is
turned."""
PICTURE_MIRRORED = PEOPLE.code("picture_mirrored", "finding", "warning", "job", "command")
"""The picture of a camera is mirrored against its calibration. | Turn off the mirroring, or mirror the video back."""
COORDINATES_EXCHANGED = PEOPLE.code("coordinates_exchanged", "finding", "warning", "job", "command")
"""x and y of a camera's keypoints are exchanged. | Write x first, then y."""
CALIBRATION_OF_ANOTHER_RIG = PEOPLE.code("calibration_of_another_rig", "finding", "warning", "job", "command")
"""No two cameras agree about people. | Give the calibration of these cameras; check the synchronisation."""
NO_COMMON_PEOPLE = PEOPLE.code("no_common_people", "finding", "warning")
"""A camera sees people, and never at the same time as another camera. | Check its offset, and where it looks."""

JOBS = CodeGroup(
    "Errors of jobs",
    "Values of `error.code` of a failed job, and of a failed attempt in `GET /v1/jobs/{id}/attempts`. Problems of"
    " videos marked `job` above can be a job's error too. `retryable` states whether another attempt may succeed.",
)

WORKER_LOST = JOBS.code("worker_lost", "job", "attempt")
"""A worker stopped responding while it worked on a chunk, most often for lack of memory. | Run fewer workers, then
retry the job."""
MEMORY_LIMIT = JOBS.code("memory_limit", "job", "command")
"""A chunk needs more memory than a worker may use, or a command more than there is. | Use fewer frames, or have the
operator raise `MULTICAP_MEMORY_BYTES`."""
TIME_LIMIT = JOBS.code("time_limit", "job", "attempt")
"""A chunk took many times as long as foreseen, twice, and was stopped. | Retry the job. The operator reads the workers'
logs, or raises `MULTICAP_CHUNK_TIME_FACTOR` on slow machines."""
INPUT_DAMAGED = JOBS.code("input_damaged", "job")
"""The service's copy of an input file is damaged or missing. | Send the capture again, or restore the file from a
backup and retry the job."""
OUTPUT_DAMAGED = JOBS.code("output_damaged", "job", "attempt")
"""A stored output of a stage was damaged. | The operator checks the disk; then retry the job."""
SYNC_NO_MOTION = JOBS.code("sync_no_motion", "job", "command")
"""A camera sees no person who moves, or too little motion to tell its offset. | Declare the offsets, or film people who
move; see [synchronization](../guide/synchronization.md#refusals)."""
SYNC_AMBIGUOUS = JOBS.code("sync_ambiguous", "job", "command")
"""The motion that a camera sees fits several offsets. | Declare the offsets, or film other motion; see
[synchronization](../guide/synchronization.md#refusals)."""
SYNC_CONTRADICTION = JOBS.code("sync_contradiction", "job", "command")
"""The sound of a camera and the motion of people tell different offsets. | Declare the offsets, or send videos without
sound; see [synchronization](../guide/synchronization.md#refusals)."""
SYNC_LITTLE_OVERLAP = JOBS.code("sync_little_overlap", "job", "command")
"""A camera recorded for too short a time together with the others. | Declare the offsets."""
SYNC_NOTHING_IN_COMMON = JOBS.code("sync_nothing_in_common", "job", "command")
"""No motion that a camera sees fits the other cameras, at any offset. | Check that it sees the same people, and its
calibration; or declare the offsets."""
SYNC_IMPRECISE = JOBS.code("sync_imprecise", "job", "command")
"""The offset of a camera is known to more than half a frame only. | Declare the offsets, or film people who move."""
SYNC_NEEDS_BODIES = JOBS.code("sync_needs_bodies", "job", "command")
"""Cameras are synchronised from whole bodies; the detector finds single joints. | Use `detector: auto`, or declare the
offsets."""
INPUT_ERROR = JOBS.code("input_error", "job")
"""The input has several problems. | Correct everything that `detail` lists."""
SESSION_REFUSED = JOBS.code("session_refused", "job")
"""The check of the capture found errors, which `errors` lists: a reconstruction would be wrong. | Correct what they
name, or reconstruct the session all the same by `force`."""
VIDEOS_FETCHING = JOBS.code("videos_fetching", "job")
"""The job waits for videos that the service fetches from URLs. | Wait: it starts by itself. The session tells how many
bytes are there."""
SESSION_UNUSABLE = JOBS.code("session_unusable", "job")
"""The files of the session, fetched from URLs, can't be used; `errors` lists everything that is wrong. | Correct it,
and send the session again."""
MODEL_ERROR = JOBS.code("model_error", "job", "command")
"""A detector network or the sample capture can't be installed or used. | Follow the message, then retry."""
CHILD_FAILED = JOBS.code("child_failed", "job", "command")
"""A process of Multicap failed; the input is not the cause. | Retry; if the process fails again, see the log."""
PIPELINE_ERROR = JOBS.code("pipeline_error", "job", "command")
"""The reconstruction failed; the message states the reason. | Follow the message."""

WARNINGS = CodeGroup(
    "Warnings of a result",
    "Codes of `warnings` of a job, and of `capture_checks` and `world_checks` in `metrics.json`. The "
    "result files exist, but the capture or the calibration may be wrong.",
)

NOBODY_FOUND = WARNINGS.code("nobody_found", "warning", "finding")
"""No person was found. | Check that the calibration belongs to the videos, and that two cameras see a person at the
same time."""
EVERYBODY_REMOVED = WARNINGS.code("everybody_removed", "warning")
"""Edits removed all people who were found. | Undo an edit: `PUT /v1/sessions/{id}/edits` with the list without it."""
EDIT_NOT_APPLIED = WARNINGS.code("edit_not_applied", "warning")
"""An edit of the capture does not apply to this run, and changes nothing in it. It stays in the list, and other runs
apply it. | Look at the frame that the warning names. Undo the edit if no run needs it, or make it again on this run."""
BODIES_CLUSTERED = WARNINGS.code("bodies_clustered", "warning", "command")
"""Clustering got whole bodies, in which it connects joints of one detection only. | Use a
detector of part affinity fields with videos, or `method: tracking`."""
OVERLAY_WITHOUT_VIDEOS = WARNINGS.code("overlay_without_videos", "warning", "command")
"""Overlay videos were asked for, and the session has keypoints alone. | Send the videos, or omit `overlay`."""
BONE_HANGS_ELSEWHERE = WARNINGS.code("bone_hangs_elsewhere", "warning", "command")
"""A hand or a foot of the character is not below its limb in the file. Its place is animated too. | Look at the motion
of this hand or foot."""
TAKE_TOO_LARGE = WARNINGS.code("take_too_large", "warning")
"""A file with the whole take would be larger than its format allows; the files of the people are there. | Ask for fewer
frames by `frame_range`, or for a lower `output_rate_hz`."""
OPENSIM_FAILED = WARNINGS.code("opensim_failed", "warning")
"""OpenSim could not scale its model to a person, or not follow the person's markers; the message says why. | See
[OpenSim](../guide/biomechanics.md#opensim). The person's archive has the setups to run it by hand."""
LABORATORY_ALIGNED = WARNINGS.code("laboratory_aligned", "warning")
"""The time of a laboratory's file was measured from contacts and vertical force, or could not be. | Check it, and state
a trigger channel or timecode if it is wrong."""
LABORATORY_DOUBTFUL = WARNINGS.code("laboratory_doubtful", "warning")
"""Feet and force plates disagree about the time of a laboratory's file or about the place of its plates. | Follow the
message."""
OWN_POINTS_DOUBTFUL = WARNINGS.code("own_points_doubtful", "warning")
"""A rigid object has no pose in any frame, or animals were tracked because `clustering` lacks their bones. | Correct
the [file](../guide/own-points.md) about your own points."""
FORCES_MISSING = WARNINGS.code("forces_missing", "warning")
"""A table of forces is empty: there are fewer than 20 frames a second, or joints of the body are missing. | Follow the
message."""
FORCES_WITHOUT_FEET = WARNINGS.code("forces_without_feet", "warning")
"""Heels and toes were never seen: where the forces act on the feet is a guess. | Use a detector with heels and toes."""
FORCES_BESIDE_FEET = WARNINGS.code("forces_beside_feet", "warning")
"""A seat, hands or another person may carry a share of the force; some forces of feet are empty. | Use these frames
with care: [Forces](../guide/biomechanics.md#forces) says what is known of them."""
TOO_FEW_CAMERAS = WARNINGS.code("too_few_cameras", 422, "warning", "finding", "job", "command")
"""The session has fewer than three cameras. | Add a camera."""
DAMAGED_VIDEO = WARNINGS.code("damaged_video", "warning")
"""Videos have damaged or missing frames. | Copy the files again; see [formats](formats.md#videos)."""
FRAMES_DOUBLED = WARNINGS.code("frames_doubled", "warning")
"""Frames of a video show the picture before once more: people lag behind there. | Record with a camera that keeps its
rate, or export without a constant rate."""
CAMERA_WITHOUT_PEOPLE = WARNINGS.code("camera_without_people", "warning", "finding")
"""A camera was matched with no person. | Check its video, its calibration and its offset."""
FEW_VIEWS = WARNINGS.code("few_views", "warning")
"""Fewer than three cameras saw a person in most frames. | Add or move cameras."""
APPROXIMATE_ASSOCIATION = WARNINGS.code("approximate_association", "warning")
"""Some frames show more people than exact methods can tell apart. | Check these frames; see
[tracking](../methods/tracking.md#crowds) and [clustering](../methods/clustering.md#crowds)."""
UNCERTAIN_IDENTITY = WARNINGS.code("uncertain_identity", "warning")
"""Two people may have been taken for each other at some moment. | Look at the moments under `identity.doubts` in
metrics.json; see [who is who](../methods/identity.md#doubts)."""
PERSON_LOST = WARNINGS.code("person_lost", "warning")
"""A person vanishes in the middle of the room: cameras view the place, and the person is not found there. | Look at the
frames and the place in the message; add cameras, or try the other `method`. See
[losses](../methods/identity.md#losses)."""
PHANTOM_ENDED = WARNINGS.code("phantom_ended", "warning")
"""A track was made of the limbs of other people for some time; these frames were taken from it. | Look at the frames in
the message: a person may have been there. See [losses](../methods/identity.md#losses)."""
LIMB_MISMEASURED = WARNINGS.code("limb_mismeasured", "warning")
"""A limb was located with a length that the person's other side or proportions exclude. The fit uses another one. |
Look at this limb: it may be hidden for most of the take. See
[the fit](../methods/fit.md#lengths-of-limbs)."""
PERSON_NEVER_MOVES = WARNINGS.code("person_never_moves", "warning")
"""A person never moves: a poster, a mannequin, or a person who sleeps. | Remove the picture if it is one (`PUT
/v1/jobs/{id}/people`); see [likenesses](../methods/identity.md#likenesses)."""
MIRROR_IMAGE = WARNINGS.code("mirror_image", "warning")
"""A person is the mirror image of another one. | Remove the image (`PUT /v1/jobs/{id}/people`), or cover the mirror;
see [likenesses](../methods/identity.md#likenesses)."""
CALIBRATION_REFINED = WARNINGS.code("calibration_refined", "warning")
"""Cameras were moved to fit the people of the take. | Use the result calibration.json for other takes; see
[refinement](../guide/calibration.md#refinement)."""
CALIBRATION_KEPT = WARNINGS.code("calibration_kept", "warning")
"""`refine_calibration` is `auto`, and the given calibration was kept: it fits about as well, or the people do not
determine the cameras. Its severity is `info`. | Nothing if the calibration fits. Otherwise let people walk all over the
place; see [refinement](../guide/calibration.md#refinement)."""
WORLD_LEVELED = WARNINGS.code("world_leveled", "warning")
"""The floor was tilted or not at z = 0, and the world was moved so that feet stand at z = 0. | Use the result
calibration.json for other takes; see [refinement](../guide/calibration.md#refinement)."""
CAMERA_BUMPED = WARNINGS.code("camera_bumped", "warning")
"""A camera was moved during the take. | Reconstruct the frames before and after the time in the message on their own
(`frame_range`)."""
SYNC_BY_SOUND = WARNINGS.code("sync_by_sound", "warning")
"""The offsets of the cameras come from their sound alone. | Look at the motion; declare the offset, or film people
who move where all cameras see them."""
SYNC_AS_DECLARED = WARNINGS.code("sync_as_declared", "warning")
"""The offsets of the cameras are the declared ones, whose uncertainty is stated: motion does not tell them. | Look at
the motion; film people who move where all cameras see them."""
SYNC_BEYOND_DECLARED = WARNINGS.code("sync_beyond_declared", "warning")
"""The measured offset of a camera is beyond the uncertainty of the declared one. | Look at the motion; the clock of the
camera was wrong, or its pictures came late."""
SYNC_UNCERTAIN = WARNINGS.code("sync_uncertain", "warning")
"""The measured clock of a camera may be wrong by up to half a frame. | Look at the motion; declare the offset, or film
people who move where all cameras see them."""
PEOPLE_FEW_VIEWS = WARNINGS.code("people_few_views", "warning")
"""A camera shares people with another camera briefly. | Let people walk where it and a neighbour see them."""
PEOPLE_POOR_FIT = WARNINGS.code("people_poor_fit", "warning")
"""People fit a camera worse than the other cameras. | Check its synchronisation, whether it moved, and its
intrinsics."""
PEOPLE_SAME_PLACE = WARNINGS.code("people_same_place", "warning")
"""Two cameras come out at nearly the same place. | Check whether one video was given twice."""
PEOPLE_UNCERTAIN_POSE = WARNINGS.code("people_uncertain_pose", "warning")
"""People determine the pose of a camera poorly. | Film longer, with people all over the place."""
PEOPLE_UNCERTAIN_FOCAL = WARNINGS.code("people_uncertain_focal", "warning")
"""People determine the focal length of a camera poorly. | Give the intrinsics, or calibrate them from a board."""
PEOPLE_STATURES = WARNINGS.code("people_statures", "warning")
"""The stated statures differ from the people's, in number or in their ratios. | State the stature of each person, or
one for all."""
PEOPLE_UNCERTAIN_FLOOR = WARNINGS.code("people_uncertain_floor", "warning")
"""The feet reach too little ground to find its slope. | Let people walk all over the place."""
BOARD_FEW_VIEWS = WARNINGS.code("board_few_views", "warning")
"""The board was found in few pictures of a camera. | Film it longer, at several distances and tilts."""
BOARD_POOR_COVERAGE = WARNINGS.code("board_poor_coverage", "warning")
"""The board covers a small part of a camera's picture. | Film it near the edges and corners too; see the picture
`coverage_CAMERA.svg`."""
BOARD_MIRRORED = WARNINGS.code("board_mirrored", "warning")
"""The board is mirrored in some pictures. | Turn off the mirroring of the camera: its videos are mirrored too."""
BOARD_AMBIGUOUS = WARNINGS.code("board_ambiguous", "warning")
"""The chessboard looks the same after half a turn, so that the world may be turned by half a turn. | Use a board with
an odd and an even number, a ChArUco board, or known points."""
BOARD_FEW_SHARED = WARNINGS.code("board_few_shared", "warning")
"""A camera is linked to the others by few views of the board. | Film the board where the camera and a neighbour both
see it."""
BOARD_DISAGREES = WARNINGS.code("board_disagrees", "warning")
"""Cameras see the board at poses that differ by much more than their own errors: they are not synchronous, their
shutters roll, the board is bent, or a lens is wrong. | `hint` has the likely cause: a delay to state, or what to film
again. Lenses rest on each camera's own views."""
BOARD_FLOOR_UNCERTAIN = WARNINGS.code("board_floor_uncertain", "warning")
"""The board never lies still on the floor, so that the floor of the world is a guess. | Lay it flat on the floor for a
second, or state the time (`--floor-time`)."""
KNOWN_POINTS_DOUBTFUL = WARNINGS.code("known_points_doubtful", "warning")
"""A known point is far from where the cameras see it, all cameras are below the points, or the points of a scene leave
a camera uncertain. | Check its coordinates and its marked pixels, and that Z points up; mark more points."""
UPSIDE_DOWN = WARNINGS.code("upside_down", "warning", "finding", "job", "command")
"""Heads are below feet. | Turn the calibration: state by `up` which axis points up."""
NOT_UPRIGHT = WARNINGS.code("not_upright", "warning", "finding", "job", "command")
"""People lean in most frames. | Check which axis points up; state it by `up` if it is not Z."""
FLOOR_NOT_AT_ZERO = WARNINGS.code("floor_not_at_zero", "warning", "finding")
"""Feet do not stand at a height of 0. | Move the calibration's origin."""
FLOOR_TILTED = WARNINGS.code("floor_tilted", "warning", "finding")
"""The floor that feet stand on is tilted. | Level the calibration."""
STATURE_OUT_OF_RANGE = WARNINGS.code("stature_out_of_range", "warning", "finding", "job", "command")
"""A person is not 1.0 to 2.3 m tall. | Check the calibration's unit."""
CAMERA_BELOW_FLOOR = WARNINGS.code("camera_below_floor", "warning", "finding")
"""A camera is below the floor. | Check the calibration's axes."""
MIRRORED_WORLD = WARNINGS.code("mirrored_world", "warning", "finding", "job", "command")
"""People's left and right are exchanged. | Check the signs of the calibration's axes, and that the videos are not
mirrored."""
CAMERA_DISAGREES = WARNINGS.code("camera_disagrees", "warning", "finding", "job", "command")
"""A camera sees people elsewhere than the other cameras do. | Refine the calibration; see
[refinement](../guide/calibration.md#refinement). Or check the camera's offset."""

FINDINGS = CodeGroup(
    "Findings of checks",
    "`multicap calibration check FILE` lists what is wrong (`error`) or doubtful (`warning`) about a calibration."
    " With videos or keypoints it lists failed checks of the people too, under the codes of warnings of a result.",
)

SAME_PLACE = FINDINGS.code("same_place", "finding", "warning", "job", "command")
"""Two cameras are at the same place; an error if they are turned alike, too. | Check whether one camera stands twice in
the file."""
WORLD_UNIT = FINDINGS.code("world_unit", 422, "finding", "warning", "job", "command")
"""The cameras are farther apart, or closer together, than in any rig. | State the unit of the calibration."""
UP_AXIS_UNKNOWN = FINDINGS.code("up_axis_unknown", "finding")
"""The cameras do not tell which axis of the calibration points up, such as cameras that look straight down. | State the
axis (`up`, `--up`) if Z does not point up; `up_axes` of the evidence has those that may."""
NO_COMMON_VIEW = FINDINGS.code("no_common_view", "finding", "warning", "job", "command")
"""No other camera sees any place that the camera sees; an error if that holds for all cameras. | Check the pose of the
camera, or turn it to the view of the others."""
FOCAL_LENGTH = FINDINGS.code("focal_length", "finding")
"""The focal length does not fit the size of the picture. | Check that the camera matrix belongs to this size, in
pixels."""
PIXELS_NOT_SQUARE = FINDINGS.code("pixels_not_square", "finding")
"""The focal lengths along x and y differ. | Check the camera matrix, unless the picture was stretched."""
PRINCIPAL_POINT = FINDINGS.code("principal_point", "finding")
"""The principal point is far from the middle of the picture. | Check that the camera matrix belongs to this size, and
that the picture was not cropped."""
DISTORTION_FOLDS = FINDINGS.code("distortion_folds", "finding", "warning", "job", "command")
"""The distortion has no inverse in a part of the picture; an error if that part is not only in the corners. | Calibrate
the lens again with views near the edges, or with fewer coefficients."""

STREAMS = CodeGroup(
    "Cameras of live captures",
    "Problems of the cameras of `multicap live` and of `start_cameras`; see [live](../start/live.md).",
)

CAMERA_SOURCE = STREAMS.code("camera_source", "command", "live")
"""`--camera` is not CAMERA=SOURCE, names an unknown camera or one twice, or there are fewer than two. | Name two
cameras of the calibration or more, each with its stream, device or file."""
STREAM_REFUSED = STREAMS.code("stream_refused", "command", "live")
"""The address of a stream answers, but gives no stream, or nothing is at the address. | Check the address, and user and
password in it."""
STREAM_SILENT = STREAMS.code("stream_silent", "command", "live")
"""A camera does not answer, or sends no pictures for seconds. | See that the camera is on and reached from this
machine."""

COMMANDS = CodeGroup(
    "Command line",
    'With `--json` a command prints `{"problems": [{"code", "message", ...}]}`. The exit code is 2 for wrong '
    "input and 1 for other failures.",
)

SOURCES = COMMANDS.code("sources", "command")
"""Options of videos and of keypoints were mixed, or neither was given. | Give `--videos`, with `--offset` if needed, or
`--keypoints`, with `--timestamps` or `--frame-rate`."""
UNKNOWN_CLOCK = COMMANDS.code("unknown_clock", "command")
"""There is no such clock of videos. | Use a name that `hint` lists."""
UNKNOWN_UNITS = COMMANDS.code("unknown_units", "command")
"""There is no such unit. | Use a name that `hint` lists."""
UNKNOWN_AXIS = COMMANDS.code("unknown_axis", "command")
"""There is no such axis. | Use a name that `hint` lists."""
UNKNOWN_PROVIDER = COMMANDS.code("unknown_provider", "command")
"""There is no such execution provider. | Use a name that `hint` lists."""
UNKNOWN_SCENE = COMMANDS.code("unknown_scene", "command")
"""There is no such simulated scene. | Use a name that `hint` lists."""
UNKNOWN_JOINTS = COMMANDS.code("unknown_joints", "command")
"""Simulated people have no such joints. | Use a name that `hint` lists."""
UNKNOWN_EVIDENCE = COMMANDS.code("unknown_evidence", "command")
"""There is no such evidence for the method. | Omit it, or use the hint."""
UNKNOWN_PARAMETER = COMMANDS.code("unknown_parameter", "command")
"""The method has no parameter of this name. | Use a name of [tracking](../methods/tracking.md#parameters) or
[clustering](../methods/clustering.md#parameters)."""
PARAMETER_RANGE = COMMANDS.code("parameter_range", "command")
"""The value of the parameter is not allowed. | Use an allowed value."""
PARAMETER_UNREADABLE = COMMANDS.code("parameter_unreadable", "command")
"""The option is not NAME=NUMBER, or not WIDTHxHEIGHT. | Write it as in the hint."""
NOTHING_BLURRED = COMMANDS.code("nothing_blurred", "command")
"""Blurred faces were asked for, without files that show faces. | Add `--overlay`, `--report` or `--exports rerun`, or
omit `--blur-faces`."""
EDITS_UNREADABLE = COMMANDS.code("edits_unreadable", "command")
"""The file of `--edits` is missing, or has no edits. | Write the edits as
[the service](../guide/people-and-edits.md#correct-people-by-the-api) has them."""
NO_REFINEMENT = COMMANDS.code("no_refinement", "command")
"""The evaluation refines calibrations from whole bodies only. | Use `--evidence bodies`, or omit `--turn`, `--shift`
and `--refine-calibration`."""
NO_ABLATION = COMMANDS.code("no_ablation", "command")
"""The method has no ablation here. | Omit `--ablation`."""
WRONG_NUMBER_OF_VIEWS = COMMANDS.code("wrong_number_of_views", "command")
"""The scene does not have so many cameras. | Ask for fewer."""
NEGATIVE_SEED = COMMANDS.code("negative_seed", "command")
"""The seed is negative. | Use 0 or more."""
DATASET_INCOMPLETE = COMMANDS.code("dataset_incomplete", "command")
"""Files of the dataset are missing. | Get the whole dataset."""
BENCHMARK_UNREADABLE = COMMANDS.code("benchmark_unreadable", "command")
"""A file of a benchmark can't be read. | Follow the message: get the file again."""
TRUTH_UNREADABLE = COMMANDS.code("truth_unreadable", "command")
"""The rendered capture's truth can't be read. | Get it again."""
SERVICE_ERROR = COMMANDS.code("service_error", "command")
"""The service refused, failed or did not start. | Follow the message."""
BAD_USAGE = COMMANDS.code("bad_usage", "command")
"""`multicap backup` was called wrongly. | Follow the message."""
BACKUP_FAILED = COMMANDS.code("backup_failed", "command")
"""The backup could not be made, read or restored. | Follow the message."""
INTERRUPTED = COMMANDS.code("interrupted", "command")
"""The command was interrupted by a signal. | Start it again."""
TAKES_UNREADABLE = COMMANDS.code("takes_unreadable", "command")
"""A batch has no takes, or its list of takes can't be read. | Give a folder with a folder for each take, or a list as
in [many takes](../guide/many-takes.md)."""
TAKE_EMPTY = COMMANDS.code("take_empty", "command")
"""A take has neither videos nor folders of keypoints. | Put the videos of all cameras, or the folder `keypoints`, into
the folder of the take."""
TAKE_UNCALIBRATED = COMMANDS.code("take_uncalibrated", "command")
"""A take has no calibration. | Give `--calibration`, or put a file `calibration.*` into the take."""
OUTPUT_EXISTS = COMMANDS.code("output_exists", "command")
"""A new file is there already, or the folder for new files has files. | Name a new file, and a new or empty folder."""
