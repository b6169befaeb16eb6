"""Problem codes of the web API: answers, fields and parts of requests, live captures, recordings, readiness."""

from pipeline.core.problems.code_group import CodeGroup

ANSWERS = CodeGroup("Responses of the API", "Values of `code` in responses of type `application/problem+json`.")

MALFORMED_REQUEST = ANSWERS.code("malformed_request", 400)
"""The request can't be read. | Correct the client."""
MALFORMED_MULTIPART = ANSWERS.code("malformed_multipart", 400)
"""The body is not a complete multipart form. | Build the form with a library, and send all of it."""
TOO_MANY_PARTS = ANSWERS.code("too_many_parts", 400)
"""The form has too many parts. | Send fewer files in one session."""
HEADER_INVALID = ANSWERS.code("header_invalid", 400)
"""A header is missing or has a value that is not allowed. | Send the header that `detail` names in the form that it
states."""
METADATA_INVALID = ANSWERS.code("metadata_invalid", 400)
"""The header `Upload-Metadata` can't be read, or its `filename` is not allowed. | Send `filename`, a space, and the
file's name as base64."""
CHECKSUM_INVALID = ANSWERS.code("checksum_invalid", 400)
"""The header `Upload-Checksum` can't be read. | Send the name of an algorithm, a space, and the digest as base64."""
CLIENT_DISCONNECTED = ANSWERS.code("client_disconnected", 400)
"""The client closed the connection too early. | Send the request again."""
KEY_REQUIRED = ANSWERS.code("key_required", 401)
"""No key came with the request, or the key is unknown, expired or revoked. | Send `Authorization: Bearer mc_...` with a
key that `multicap keys create` made."""
LINK_UNKNOWN = ANSWERS.code("link_unknown", 401)
"""The link in the address is not known, has ended or was revoked. | Ask for a new link."""
SCOPE_MISSING = ANSWERS.code("scope_missing", 403)
"""The key does not have the scope that the call needs. | Ask the operator for a key with that scope."""
HOST_NOT_ALLOWED = ANSWERS.code("host_not_allowed", 403)
"""The request's `Host` is not a name of the service. | Call the service by localhost, or add the name to
`MULTICAP_ALLOWED_HOSTS`."""
ORIGIN_NOT_ALLOWED = ANSWERS.code("origin_not_allowed", 403)
"""A web page of another origin made the request. | If it is your page, add its origin to `MULTICAP_ALLOWED_ORIGINS`."""
CROSS_SITE_REQUEST = ANSWERS.code("cross_site_request", 403)
"""A page other than the service's own used the browser's cookie. | Call with a key from such pages."""
QUOTA_EXCEEDED = ANSWERS.code("quota_exceeded", 403, 429)
"""The tenant has as many sessions, bytes, uploads or unfinished jobs as it may have. | On 403 delete sessions that are
no longer needed; on 429 wait until a job has ended."""
NOT_FOUND = ANSWERS.code("not_found", 404)
"""There is no such address, session, job, upload or result for this tenant. | Check the address and the key's
tenant."""
METHOD_NOT_ALLOWED = ANSWERS.code("method_not_allowed", 405)
"""The address does not accept this method. | Use a method that the header `Allow` lists."""
CLIENT_TOO_SLOW = ANSWERS.code("client_too_slow", 408)
"""The headers or the body arrived too slowly. | Send the request again over a faster connection; use `/v1/uploads` for
large files."""
CONFLICT = ANSWERS.code("conflict", 409)
"""The state of the job, session or upload does not allow the call. | Read the job again and do what its state
allows."""
NOT_FINISHED = ANSWERS.code("not_finished", 409)
"""The job has no results yet. | Wait until its state is `succeeded`."""
NO_RESULTS = ANSWERS.code("no_results", 409)
"""The job ended without results. | Read the job's error; `hint` says whether to retry the job or to correct the
input."""
OFFSET_MISMATCH = ANSWERS.code("offset_mismatch", 409)
"""`Upload-Offset` is not the number of bytes that the service has. | Ask for the offset with HEAD and continue from
there."""
IDEMPOTENCY_KEY_BUSY = ANSWERS.code("idempotency_key_busy", 409)
"""The first request with this `Idempotency-Key` is still running. | Send the request again after `Retry-After`
seconds."""
IDEMPOTENCY_KEY_REUSED = ANSWERS.code("idempotency_key_reused", 422)
"""This `Idempotency-Key` was used for another request. | Use a new key for each request."""
CLIPS_MISSING = ANSWERS.code("clips_missing", 409)
"""No phone has sent its clip of the take of a recording. | Ask the phones for it by `upload`, and wait until they have
sent it."""
VIDEOS_DELETED = ANSWERS.code("videos_deleted", 409, 410, 422, "job")
"""The videos of the session were deleted, and what is asked for needs them: to detect people, to draw over them, to
show or to copy them. | Use the results of the session's jobs; else send the videos again as a new session."""
EXPIRED = ANSWERS.code("expired", 410)
"""The result file was removed. | Start another job of the session."""
CHANGED_MEANWHILE = ANSWERS.code("changed_meanwhile", 412)
"""`If-Match` names an earlier version of the record. | Read the record again, then send the change with its present
`ETag`."""
TUS_VERSION = ANSWERS.code("tus_version", 412)
"""The header `Tus-Resumable` is missing or names another version. | Send `Tus-Resumable: 1.0.0`."""
CONTENT_TOO_LARGE = ANSWERS.code("content_too_large", 413)
"""The request, or a part of it, is larger than the service accepts. | Send less; `errors` names the part and the
limit."""
UNSUPPORTED_MEDIA_TYPE = ANSWERS.code("unsupported_media_type", 415)
"""The address does not accept this `Content-Type`. | Send the type that `detail` or `hint` names."""
RANGE_NOT_SATISFIABLE = ANSWERS.code("range_not_satisfiable", 416)
"""The file does not have the requested range of bytes. | Request a range within the size that `Content-Range`
states."""
INVALID_REQUEST = ANSWERS.code("invalid_request", 422)
"""Fields, parts or files of the request are wrong. | Correct everything that `errors` lists."""
UPLOAD_ELSEWHERE = ANSWERS.code("upload_elsewhere", 421, 422)
"""The bytes of this upload are at another API process. | The operator sets MULTICAP_SHARED_UPLOADS, or routes all
requests of a client to one API process (sticky sessions); or begin the upload again."""
UPLOAD_LOCKED = ANSWERS.code("upload_locked", 423)
"""Another request is writing to this upload. | Send the piece again in a moment."""
CHECKSUM_MISMATCH = ANSWERS.code("checksum_mismatch", 460)
"""The piece that arrived does not have the checksum that was sent with it. | Send the piece again."""
TOO_MANY_REQUESTS = ANSWERS.code("too_many_requests", 429)
"""The tenant made more requests in a minute than it may. | Wait for `Retry-After` seconds; follow jobs by event
streams."""
TOO_MANY_WRONG_KEYS = ANSWERS.code("too_many_wrong_keys", 429)
"""Too many wrong keys came from this address within a minute. | Correct the key; a valid key is served at once."""
TOO_MANY_STREAMS = ANSWERS.code("too_many_streams", 429)
"""The tenant has too many event streams open. | Close the streams of jobs that are no longer followed."""
TOO_MANY_CAPTURES = ANSWERS.code("too_many_captures", 429)
"""The tenant has too many live captures open. | End live captures that are over."""
TOO_MANY_BAD_CAPTURES = ANSWERS.code("too_many_bad_captures", 429)
"""Too many live captures of the tenant, or without keys of the client's address, ended by problems within a minute. |
Correct the client as the problems say, and begin the next capture after the seconds of `Retry-After`."""
CAPTURES_BUSY = ANSWERS.code("captures_busy", 503)
"""The service has as many live captures as it can compute. | Connect again later."""
TOO_MANY_AT_ONCE = ANSWERS.code("too_many_at_once", 429)
"""Too many requests of this tenant wait to be answered. | Wait for the answers of earlier requests before you send
more."""
SERVICE_BUSY = ANSWERS.code("service_busy", 503)
"""The service is busy with the requests of other tenants. | Send the request again after `Retry-After` seconds."""
TOO_MANY_CHECKS = ANSWERS.code("too_many_checks", 429)
"""Too many sessions of this tenant are being checked. | Send the capture again after `Retry-After` seconds; uploads
need not be sent again."""
CHECKS_BUSY = ANSWERS.code("checks_busy", 503)
"""The service is busy with the checks of other tenants' sessions. | Send the capture again after `Retry-After`
seconds."""
NOT_READY = ANSWERS.code("not_ready", 503)
"""`/readyz` only: no worker could start a chunk now. | See `errors` for the part that is missing."""
DATABASE_UNAVAILABLE = ANSWERS.code("database_unavailable", 503, "readyz", "waiting")
"""The database does not respond. | Send the request again later; the operator starts the database."""
DATABASE_DAMAGED = ANSWERS.code("database_damaged", 503, "readyz", "command")
"""SQLite can't read its file. | The operator restores a backup, see
[backup](../operate/backup.md#when-the-database-is-damaged)."""
ARTIFACTS_UNAVAILABLE = ANSWERS.code("artifacts_unavailable", 503, "readyz", "waiting")
"""The artifact store does not respond. Jobs wait for it. | Send the request again later; the operator starts the store.
Nothing has to be done for jobs."""
ARTIFACTS_REFUSED = ANSWERS.code("artifacts_refused", 503, "job")
"""The artifact store responds and refuses the service: the keys are wrong, or the bucket is missing. | The operator
checks `MULTICAP_ARTIFACTS_URL`, its bucket and its keys; then retry the job."""
STORAGE_FULL = ANSWERS.code("storage_full", 507, "readyz", "job")
"""The service's disk is full. | Delete captures that are no longer needed, then send the request again or retry the
job."""
SPACE_MISSING = ANSWERS.code("space_missing", 507, "command")
"""A reconstruction is foreseen to need more space than is free; nothing of it was started. | Free space, ask for fewer
files, or reconstruct fewer frames at a time by `frame_range`."""
RESULT_DAMAGED = ANSWERS.code("result_damaged", 500)
"""The content of a stored result file has changed since it was written. | Start another job of the session with the
same spec: it writes the file again."""
ARTIFACT_DAMAGED = ANSWERS.code("artifact_damaged", 500)
"""The content of a stored file has changed since it was written. | The operator checks the disk of the artifact
store."""
PREFLIGHT_FAILED = ANSWERS.code("preflight_failed", 500)
"""The check of the files failed; the files are not the cause. | Send the capture again; the operator finds the reason
in `api.log`."""
INTERNAL_ERROR = ANSWERS.code("internal_error", 500, "job")
"""The service failed. | Send the request again; the operator finds the request or the chunk in the log."""

FIELDS = CodeGroup(
    "Fields and parameters",
    "Values of `code` in the `errors` of a response `invalid_request`; `pointer` leads to the field.",
)

UNKNOWN_FIELD = FIELDS.code("unknown_field", 422, "command")
"""The object has no such field. | Remove it or correct its name."""
MISSING_FIELD = FIELDS.code("missing_field", 422)
"""A required field or parameter is missing. | Add it."""
MALFORMED_JSON = FIELDS.code("malformed_json", 400, 422)
"""The body, or the part of the form, is not JSON. | Send JSON."""
WRONG_TYPE = FIELDS.code("wrong_type", 422, "command")
"""The value has a type that the field does not allow. | Send the type in `message`."""
VALUE_NOT_ALLOWED = FIELDS.code("value_not_allowed", 422, "command")
"""The value is not allowed. | Send a value that `message` lists."""
OUT_OF_RANGE = FIELDS.code("out_of_range", 422, "command")
"""The number is outside of its limits. | Send a number within the limits."""
WRONG_LENGTH = FIELDS.code("wrong_length", 422, "command")
"""The text or list is too short or too long. | Send a text or list of the length that `message` states."""
WRONG_FORMAT = FIELDS.code("wrong_format", 422, "command")
"""The text does not have the required form. | Use the form in `message`."""
CONTROL_CHARACTERS = FIELDS.code("control_characters", 422)
"""The text contains control characters. | Remove them."""
JSON_VALUE = FIELDS.code("json_value", 422)
"""The value is not valid JSON: NaN, infinity or a lone surrogate. | Remove it."""
EXPORT_REPEATED = FIELDS.code("export_repeated", 422, "command")
"""A format is named twice in `exports`. | Name each format once."""
INVALID_VALUE = FIELDS.code("invalid_value", 422, "command")
"""The value is wrong in another way. | Read `message`."""
MORE_PROBLEMS = FIELDS.code("more_problems", 422, "command")
"""There are more problems than the listed problems. | Correct the listed problems first."""

PARTS = CodeGroup(
    "Parts and files of a form",
    "Values of `code` in the `errors` of responses to `POST /v1/sessions` and `POST /v1/jobs`; `pointer` leads to"
    " the part.",
)

MISSING_PART = PARTS.code("missing_part", 422)
"""The calibration is missing, or both videos and keypoints are. | Add the part."""
UNKNOWN_PART = PARTS.code("unknown_part", 422)
"""The form has a part with an unknown name. | Rename or remove it."""
DUPLICATE_PART = PARTS.code("duplicate_part", 422)
"""A part that is allowed once was sent twice. | Send it once."""
PART_NOT_ALLOWED = PARTS.code("part_not_allowed", 422)
"""Files that exclude each other were sent, or the method of a calibration has no use for one. | Send either videos or
keypoints, timestamps with keypoints only, a calibration or its id."""
TOO_MANY_VIDEOS = PARTS.code("too_many_videos", 422)
"""The session has more cameras, or more videos, than allowed. | Send fewer cameras."""
TOO_MANY_IMAGES = PARTS.code("too_many_images", 422)
"""There are more archives of images than allowed. | Send fewer cameras."""
TOO_MANY_KEYPOINTS = PARTS.code("too_many_keypoints", 422)
"""The session has more archives than allowed. | Send fewer cameras."""
FILE_NAME_INVALID = PARTS.code("file_name_invalid", 422)
"""The file's name is empty, too long, a path, or has control characters. | Rename the file."""
DUPLICATE_FILE_NAME = PARTS.code("duplicate_file_name", 422)
"""Two files of the session have the same name. | Rename one of them."""
CAMERAS_OF_KEYPOINTS = PARTS.code("cameras_of_keypoints", 422)
"""`offset_s`, `offset_std_s`, `rate` or `more_files` of a camera in the manifest was sent with keypoints. | Omit it:
timestamps or a frame rate state the times. Only `file` can be stated."""
CALIBRATION_UNKNOWN = PARTS.code("calibration_unknown", 422)
"""There is no calibration with this id. | List the calibrations, or send the file."""
SESSION_UNKNOWN = PARTS.code("session_unknown", 422)
"""There is no session with this id. | List the sessions, or send the files."""
NOT_A_CAPTURE = PARTS.code("not_a_capture", 422)
"""The session was sent for a calibration, and is no capture. | Name a session whose cameras have intrinsics, or send
videos."""
CALIBRATION_UNMADE = PARTS.code("calibration_unmade", 422)
"""The calibration is being made, or its job has failed. | Wait for its job, or read the job's error."""
CALIBRATION_UNPOSED = PARTS.code("calibration_unposed", 422, "command", "finding")
"""The calibration has the intrinsics of its cameras, and no poses. | Send the extrinsics too, or make a calibration
from videos in which the cameras see the same board or people."""
UPLOAD_UNKNOWN = PARTS.code("upload_unknown", 422)
"""There is no such upload, or it was used or has expired. | Send the file again."""
UPLOAD_UNFINISHED = PARTS.code("upload_unfinished", 422)
"""The upload is not complete. | Send the rest of the file first, or wait until it is fetched."""
SOURCE_REFUSED = PARTS.code("source_refused", 422)
"""The URL of a video has a fault, is not https, or leads to an address that is not public. | Send a public https
link."""
SOURCE_NOT_FOUND = PARTS.code("source_not_found", 422)
"""The source of a video answers with an error or a redirect. | Send a link that gives the file itself and has not
expired."""
SOURCE_UNUSABLE = PARTS.code("source_unusable", 422)
"""The source of a video states no size, or compresses the file. | Have the source send `Content-Length`, and no
`Content-Encoding`; or send the file as an upload."""
SOURCE_CHANGED = PARTS.code("source_changed", 422)
"""The file at the URL of a video changed while it was fetched, or has another size than announced. | Send the request
again when the file stays as it is."""
SOURCE_BROKEN = PARTS.code("source_broken", 422)
"""The connection to the source of a video fails, breaks or is too slow, again and again. | Check that the source can be
reached, then send the request again."""
PART_TOO_LARGE = PARTS.code("part_too_large", 413)
"""A file or part is larger than allowed. | Send a smaller file."""
SESSION_TOO_LARGE = PARTS.code("session_too_large", 413, 422, "command")
"""The session's files, or the data read from them, are larger than the service accepts. | Cut it into several
sessions."""
FILE_TOO_LARGE = PARTS.code("file_too_large", 413)
"""The upload was announced larger than allowed. | Send a smaller file."""
PIECE_TOO_LARGE = PARTS.code("piece_too_large", 413)
"""The piece goes beyond the end of the upload. | Send the rest only."""
PREFLIGHT_TIMEOUT = PARTS.code("preflight_timeout", 422)
"""The check of the files took too long. | Send fewer or smaller files, or try again when the service is less busy."""
FRAMES_TOO_LARGE = PARTS.code("frames_too_large", 422)
"""The video's frames have more pixels than the operator allows. | Lower the resolution of the video, and calibrate at
that size."""

SPECS = CodeGroup("Spec of a job", "Values of `code` in `errors`, also for the options of `multicap reconstruct`.")

FRAME_RANGE = SPECS.code("frame_range", 422, "command")
"""The session does not have these output frames. | Use frames of the session."""
CUTOFF_RANGE = SPECS.code("cutoff_range", 422, "command")
"""The cutoff is not below half of the frame rate. | Use 6 Hz."""
FORMAT_NOT_INSTALLED = SPECS.code("format_not_installed", 422, "command")
"""The package that writes a format is not installed, or not on every ready worker. | Run the command in `hint`, of a
service on the workers' machine, or use another format."""
DETECTOR_NOT_INSTALLED = SPECS.code("detector_not_installed", 422)
"""Not every ready worker has the networks of the job. | The operator runs the command in `hint` on the workers'
machine."""
BODY_NOT_INSTALLED = SPECS.code("body_not_installed", 422)
"""Not every ready worker has the body that the job's files shall have. | The operator runs the command in `hint` on the
workers' machine; or choose `capsules`."""
CHARACTER_UNKNOWN = SPECS.code("character_unknown", 422)
"""There is no character with this id. | List the characters, or send the file."""
CALLBACK_INVALID = SPECS.code("callback_invalid", 422)
"""`callback_url` has an impossible host or port. | Correct it."""
CALLBACK_NOT_HTTPS = SPECS.code("callback_not_https", 422)
"""`callback_url` is not https. | Use https."""
CALLBACK_NOT_PUBLIC = SPECS.code("callback_not_public", 422)
"""`callback_url` is not a public address. | Use a public address."""
WEBHOOK_SECRET_MISSING = SPECS.code("webhook_secret_missing", 422)
"""The tenant has no secret that signs webhooks. | The operator runs `multicap webhooks rotate`."""

LIVE = CodeGroup(
    "Live captures",
    "Values of `code` in the messages `problem` of `WS /v1/live`; see [live captures](live-protocol.md).",
)

LIVE_MESSAGE = LIVE.code("live_message", "live")
"""A message is not JSON in UTF-8, not an object, or not of a type that is expected at this point. | Send `start` first,
then `keypoints` or packed keypoints, and `end` last."""
LIVE_FIELDS = LIVE.code("live_fields", "live")
"""Fields of a message are missing or wrong; `errors` lists all of them. | Correct the fields that `errors` lists, and
start again."""
LIVE_PACKET = LIVE.code("live_packet", "live")
"""A packed message does not have the form, the numbers or the length that it states. | Follow the table of packed
keypoints; all numbers are finite and little-endian."""
LIVE_CAMERA = LIVE.code("live_camera", "live")
"""Keypoints are of a camera that the calibration does not have. | Name a camera of the message `ready`, or send its
place in that list."""
LIVE_JOINTS = LIVE.code("live_joints", "live")
"""A person has another number of points than the layout of the capture. | Send all points of the layout; points that
were not found have the score 0."""
LIVE_TOO_LARGE = LIVE.code("live_too_large", "live")
"""A message has more bytes, or more people, than the service accepts. | Send one camera's frame in a message, with at
most as many people as the service allows."""
LIVE_TOO_FAST = LIVE.code("live_too_fast", "live")
"""The client sends more messages a second than the service accepts. | Send each camera's frames at their own rate."""
LIVE_TIME = LIVE.code("live_time", "live")
"""The time of a frame is far ahead of all others. | Send times in seconds on one clock of all cameras; after a long
pause begin another capture."""
LIVE_IDLE = LIVE.code("live_idle", "live")
"""The client sent nothing, or received nothing, for too long. | Send frames without people too, read what comes, and
send `end` when the capture is over."""
LIVE_KEY_ENDED = LIVE.code("live_key_ended", "live")
"""The key of the connection was revoked or has expired. | Connect with a valid key."""
LIVE_FAILED = LIVE.code("live_failed", "live")
"""The computation of the capture failed or did not answer in time; other captures go on. | Start the capture again; if
it fails again, send the operator the `request_id`."""
LIVE_STOPPED = LIVE.code("live_stopped", "live")
"""The service was stopped during the capture, and closed the connection with 1012; nothing of the capture is kept. |
Begin another capture when the service answers again."""

RECORDINGS = CodeGroup(
    "Recordings by phones",
    "Values of `code` in the messages `problem` of `WS /v1/recordings/{recording_id}/connect`; see "
    "[recordings](recording-protocol.md).",
)

RECORDING_MESSAGE = RECORDINGS.code("recording_message", "recording")
"""A message is not JSON in UTF-8, not an object, or not of a type that is expected at this point. | A phone sends
`hello` first; then send messages of the types that `/recordings.asyncapi.json` lists."""
RECORDING_FIELDS = RECORDINGS.code("recording_fields", "recording")
"""Fields of a message are missing or wrong; `errors` lists all of them. | Correct the fields that `errors` lists, and
connect again."""
RECORDING_THUMBNAIL = RECORDINGS.code("recording_thumbnail", "recording")
"""A message of bytes is no JPEG of at most 1,024 pixels a side, has no finite time where it has one, or comes from a
host. | Send small JPEGs of the camera's picture, from phones alone."""
RECORDING_TOO_LARGE = RECORDINGS.code("recording_too_large", "recording")
"""A message or a picture has more bytes than the service accepts. | Keep to `limits` of the message `welcome`."""
RECORDING_TOO_FAST = RECORDINGS.code("recording_too_fast", "recording")
"""The client sends more messages a second than the service accepts. | Keep to `limits` of the message `welcome`."""
RECORDING_IDLE = RECORDINGS.code("recording_idle", "recording")
"""A phone sent nothing, or a client received nothing, for too long. | Connect again; a phone sends `status` every
second."""
RECORDING_BUSY = RECORDINGS.code("recording_busy", "recording")
"""The recording has as many hosts connected, or as many connections that have not said hello, as it may have. | Close
pages of the recording that are not needed; phones connect again after a moment."""
RECORDING_LINK_ENDED = RECORDINGS.code("recording_link_ended", "recording")
"""The link or the key of the connection is no longer valid. | Open the newest link, or sign in again."""

EDITS = CodeGroup(
    "Edits of people", "Values of `code` in `errors` of `PUT /v1/sessions/{id}/edits`; `pointer` leads to the edit."
)

EDIT_IMPOSSIBLE = EDITS.code("edit_impossible", 422)
"""The edit can't be made at this point: there is no such person or frame, or the name is taken. | Read the edits again.
Each edit is applied to the people that the edits before it leave."""
EDITS_FRAGMENTED = EDITS.code("edits_fragmented", 422)
"""After this edit the people would consist of more pieces of the people who were found than are allowed. | Leave this
edit out, or exchange people in fewer places."""

READINESS = CodeGroup(
    "Readiness",
    "Values of `code` in the `errors` of a 503 of `GET /readyz`, beside `database_unavailable`, "
    "`database_damaged`, `artifacts_unavailable` and `storage_full` above.",
)

BROKER_UNAVAILABLE = READINESS.code("broker_unavailable", "readyz", "waiting")
"""The broker does not respond. Queued work waits for it. | Start the broker."""
DISK_UNAVAILABLE = READINESS.code("disk_unavailable", "readyz")
"""The disk of the data folder does not respond. | Check the disk, or the machine that shares it."""
WORKER_UNAVAILABLE = READINESS.code("worker_unavailable", "readyz")
"""No worker runs. | Start a worker, and see its log."""
WORKER_STARTING = READINESS.code("worker_starting", "readyz")
"""The workers are starting; `message` states their progress. | Wait."""
MODEL_UNAVAILABLE = READINESS.code("model_unavailable", "readyz")
"""A worker lacks a network of the default profile. | Run the command in `hint` on the workers' machine."""
