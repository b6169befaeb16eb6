"""Problem codes of the API's responses, and of the fields and parts of a request."""

from api.contract.problem_codes.model import CodeGroup, ProblemCode

_FIELD = ("422",)
# Of choices of a reconstruction, too, which the command line checks by the same rules.
_CHOICE = ("422", "command")

ANSWERS = CodeGroup(
    "Responses of the API",
    "Values of `code` in responses of type `application/problem+json`.",
    (
        ProblemCode("malformed_request", ("400",), "The request can't be read.", "Correct the client."),
        ProblemCode(
            "malformed_multipart",
            ("400",),
            "The body is not a complete multipart form.",
            "Build the form with a library, and send all of it.",
        ),
        ProblemCode("too_many_parts", ("400",), "The form has too many parts.", "Send fewer files in one session."),
        ProblemCode(
            "header_invalid",
            ("400",),
            "A header is missing or has a value that is not allowed.",
            "Send the header that `detail` names in the form that it states.",
        ),
        ProblemCode(
            "metadata_invalid",
            ("400",),
            "The header `Upload-Metadata` can't be read, or its `filename` is not allowed.",
            "Send `filename`, a space, and the file's name as base64.",
        ),
        ProblemCode(
            "checksum_invalid",
            ("400",),
            "The header `Upload-Checksum` can't be read.",
            "Send the name of an algorithm, a space, and the digest as base64.",
        ),
        ProblemCode(
            "client_disconnected", ("400",), "The client closed the connection too early.", "Send the request again."
        ),
        ProblemCode(
            "key_required",
            ("401",),
            "No key came with the request, or the key is unknown, expired or revoked.",
            "Send `Authorization: Bearer mc_...` with a key that `multicap keys create` made.",
        ),
        ProblemCode(
            "link_unknown",
            ("401",),
            "The link in the address is not known, has ended or was revoked.",
            "Ask for a new link.",
        ),
        ProblemCode(
            "scope_missing",
            ("403",),
            "The key does not have the scope that the call needs.",
            "Ask the operator for a key with that scope.",
        ),
        ProblemCode(
            "host_not_allowed",
            ("403",),
            "The request's `Host` is not a name of the service.",
            "Call the service by localhost, or add the name to `MULTICAP_ALLOWED_HOSTS`.",
        ),
        ProblemCode(
            "origin_not_allowed",
            ("403",),
            "A web page of another origin made the request.",
            "If it is your page, add its origin to `MULTICAP_ALLOWED_ORIGINS`.",
        ),
        ProblemCode(
            "cross_site_request",
            ("403",),
            "A page other than the service's own used the browser's cookie.",
            "Call with a key from such pages.",
        ),
        ProblemCode(
            "quota_exceeded",
            ("403", "429"),
            "The tenant has as many sessions, bytes, uploads or unfinished jobs as it may have.",
            "On 403 delete sessions that are no longer needed; on 429 wait until a job has ended.",
        ),
        ProblemCode(
            "not_found",
            ("404",),
            "There is no such address, session, job, upload or result for this tenant.",
            "Check the address and the key's tenant.",
        ),
        ProblemCode(
            "method_not_allowed",
            ("405",),
            "The address does not accept this method.",
            "Use a method that the header `Allow` lists.",
        ),
        ProblemCode(
            "client_too_slow",
            ("408",),
            "The headers or the body arrived too slowly.",
            "Send the request again over a faster connection; use `/v1/uploads` for large files.",
        ),
        ProblemCode(
            "conflict",
            ("409",),
            "The state of the job, session or upload does not allow the call.",
            "Read the job again and do what its state allows.",
        ),
        ProblemCode("not_finished", ("409",), "The job has no results yet.", "Wait until its state is `succeeded`."),
        ProblemCode(
            "no_results",
            ("409",),
            "The job ended without results.",
            "Read the job's error; `hint` says whether to retry the job or to correct the input.",
        ),
        ProblemCode(
            "offset_mismatch",
            ("409",),
            "`Upload-Offset` is not the number of bytes that the service has.",
            "Ask for the offset with HEAD and continue from there.",
        ),
        ProblemCode(
            "idempotency_key_busy",
            ("409",),
            "The first request with this `Idempotency-Key` is still running.",
            "Send the request again after `Retry-After` seconds.",
        ),
        ProblemCode(
            "idempotency_key_reused",
            ("422",),
            "This `Idempotency-Key` was used for another request.",
            "Use a new key for each request.",
        ),
        ProblemCode("expired", ("410",), "The result file was removed.", "Start another job of the session."),
        ProblemCode(
            "changed_meanwhile",
            ("412",),
            "`If-Match` names an earlier version of the record.",
            "Read the record again, then send the change with its present `ETag`.",
        ),
        ProblemCode(
            "tus_version",
            ("412",),
            "The header `Tus-Resumable` is missing or names another version.",
            "Send `Tus-Resumable: 1.0.0`.",
        ),
        ProblemCode(
            "content_too_large",
            ("413",),
            "The request, or a part of it, is larger than the service accepts.",
            "Send less; `errors` names the part and the limit.",
        ),
        ProblemCode(
            "unsupported_media_type",
            ("415",),
            "The address does not accept this `Content-Type`.",
            "Send the type that `detail` or `hint` names.",
        ),
        ProblemCode(
            "range_not_satisfiable",
            ("416",),
            "The file does not have the requested range of bytes.",
            "Request a range within the size that `Content-Range` states.",
        ),
        ProblemCode(
            "invalid_request",
            ("422",),
            "Fields, parts or files of the request are wrong.",
            "Correct everything that `errors` lists.",
        ),
        ProblemCode(
            "upload_elsewhere",
            ("421", "422"),
            "The bytes of this upload are at another API process.",
            "The operator routes all requests of a client to one API process (sticky sessions); or begin the upload "
            "again.",
        ),
        ProblemCode(
            "upload_locked",
            ("423",),
            "Another request is writing to this upload.",
            "Send the piece again in a moment.",
        ),
        ProblemCode(
            "checksum_mismatch",
            ("460",),
            "The piece that arrived does not have the checksum that was sent with it.",
            "Send the piece again.",
        ),
        ProblemCode(
            "too_many_requests",
            ("429",),
            "The tenant made more requests in a minute than it may.",
            "Wait for `Retry-After` seconds; follow jobs by event streams.",
        ),
        ProblemCode(
            "too_many_wrong_keys",
            ("429",),
            "Too many wrong keys came from this address within a minute.",
            "Correct the key; a valid key is served at once.",
        ),
        ProblemCode(
            "too_many_streams",
            ("429",),
            "The tenant has too many event streams open.",
            "Close the streams of jobs that are no longer followed.",
        ),
        ProblemCode(
            "too_many_at_once",
            ("429",),
            "Too many requests of this tenant wait to be answered.",
            "Wait for the answers of earlier requests before you send more.",
        ),
        ProblemCode(
            "service_busy",
            ("503",),
            "The service is busy with the requests of other tenants.",
            "Send the request again after `Retry-After` seconds.",
        ),
        ProblemCode(
            "too_many_checks",
            ("429",),
            "Too many sessions of this tenant are being checked.",
            "Send the session again after `Retry-After` seconds; uploads need not be sent again.",
        ),
        ProblemCode(
            "checks_busy",
            ("503",),
            "The service is busy with the checks of other tenants' sessions.",
            "Send the session again after `Retry-After` seconds.",
        ),
        ProblemCode(
            "not_ready",
            ("503",),
            "`/readyz` only: no worker could start a chunk now.",
            "See `errors` for the part that is missing.",
        ),
        ProblemCode(
            "database_unavailable",
            ("503", "readyz", "waiting"),
            "The database does not respond.",
            "Send the request again later; the operator starts the database.",
        ),
        ProblemCode(
            "database_damaged",
            ("503", "readyz", "command"),
            "SQLite can't read its file.",
            "The operator restores a backup, see [operations](operations.md#when-the-database-is-damaged).",
        ),
        ProblemCode(
            "artifacts_unavailable",
            ("503", "readyz", "waiting"),
            "The artifact store does not respond. Jobs wait for it.",
            "Send the request again later; the operator starts the store. Nothing has to be done for jobs.",
        ),
        ProblemCode(
            "artifacts_refused",
            ("503", "job"),
            "The artifact store responds and refuses the service: the keys are wrong, or the bucket is missing.",
            "The operator checks `MULTICAP_ARTIFACTS_URL`, its bucket and its keys; then retry the job.",
        ),
        ProblemCode(
            "storage_full",
            ("507", "readyz", "job"),
            "The service's disk is full.",
            "Delete sessions that are no longer needed, then send the request again or retry the job.",
        ),
        ProblemCode(
            "result_damaged",
            ("500",),
            "The content of a stored result file has changed since it was written.",
            "Start another job of the session with the same spec: it writes the file again.",
        ),
        ProblemCode(
            "artifact_damaged",
            ("500",),
            "The content of a stored file has changed since it was written.",
            "The operator checks the disk of the artifact store.",
        ),
        ProblemCode(
            "preflight_failed",
            ("500",),
            "The check of the files failed; the files are not the cause.",
            "Send the session again; the operator finds the reason in `api.log`.",
        ),
        ProblemCode(
            "internal_error",
            ("500", "job"),
            "The service failed.",
            "Send the request again; the operator finds the request or the chunk in the log.",
        ),
    ),
)

FIELDS = CodeGroup(
    "Fields and parameters",
    "Values of `code` in the `errors` of a response `invalid_request`; `pointer` leads to the field.",
    (
        ProblemCode(
            "unknown_field", ("422", "command"), "The object has no such field.", "Remove it or correct its name."
        ),
        ProblemCode("missing_field", _FIELD, "A required field or parameter is missing.", "Add it."),
        ProblemCode("malformed_json", ("400", "422"), "The body, or the part of the form, is not JSON.", "Send JSON."),
        ProblemCode(
            "wrong_type", _CHOICE, "The value has a type that the field does not allow.", "Send the type in `message`."
        ),
        ProblemCode("value_not_allowed", _CHOICE, "The value is not allowed.", "Send a value that `message` lists."),
        ProblemCode(
            "out_of_range", _CHOICE, "The number is outside of its limits.", "Send a number within the limits."
        ),
        ProblemCode(
            "wrong_length",
            _CHOICE,
            "The text or list is too short or too long.",
            "Send a text or list of the length that `message` states.",
        ),
        ProblemCode("wrong_format", _CHOICE, "The text does not have the required form.", "Use the form in `message`."),
        ProblemCode("control_characters", _FIELD, "The text contains control characters.", "Remove them."),
        ProblemCode(
            "json_value", _FIELD, "The value is not valid JSON: NaN, infinity or a lone surrogate.", "Remove it."
        ),
        ProblemCode("export_repeated", _CHOICE, "A format is named twice in `exports`.", "Name each format once."),
        ProblemCode("invalid_value", _CHOICE, "The value is wrong in another way.", "Read `message`."),
        ProblemCode(
            "more_problems",
            ("422", "command"),
            "There are more problems than the listed problems.",
            "Correct the listed problems first.",
        ),
    ),
)

PARTS = CodeGroup(
    "Parts and files of a form",
    "Values of `code` in the `errors` of responses to `POST /v1/sessions` and `POST /v1/jobs`; `pointer` leads to the "
    "part.",
    (
        ProblemCode(
            "missing_part", _FIELD, "The calibration is missing, or both videos and keypoints are.", "Add the part."
        ),
        ProblemCode("unknown_part", _FIELD, "The form has a part with an unknown name.", "Rename or remove it."),
        ProblemCode("duplicate_part", _FIELD, "A part that is allowed once was sent twice.", "Send it once."),
        ProblemCode(
            "part_not_allowed",
            _FIELD,
            "Files that exclude each other were sent, or the method of a calibration has no use for one.",
            "Send either videos or keypoints, timestamps with keypoints only, a calibration or its id.",
        ),
        ProblemCode("too_many_videos", _FIELD, "The session has more videos than allowed.", "Send fewer cameras."),
        ProblemCode(
            "too_many_images", _FIELD, "There are more archives of images than allowed.", "Send fewer cameras."
        ),
        ProblemCode("too_many_keypoints", _FIELD, "The session has more archives than allowed.", "Send fewer cameras."),
        ProblemCode(
            "file_name_invalid",
            _FIELD,
            "The file's name is empty, too long, a path, or has control characters.",
            "Rename the file.",
        ),
        ProblemCode(
            "duplicate_file_name", _FIELD, "Two files of the session have the same name.", "Rename one of them."
        ),
        ProblemCode(
            "cameras_of_keypoints",
            _FIELD,
            "`cameras` of the manifest was sent with keypoints.",
            "Omit it: timestamps and the names of the archives state the same.",
        ),
        ProblemCode(
            "calibration_unknown",
            _FIELD,
            "There is no calibration with this id.",
            "List the calibrations, or send the file.",
        ),
        ProblemCode(
            "session_unknown",
            _FIELD,
            "There is no session with this id.",
            "List the sessions, or send the files.",
        ),
        ProblemCode(
            "not_a_capture",
            _FIELD,
            "The session was sent for a calibration, and is no capture.",
            "Name a session whose cameras have intrinsics, or send videos.",
        ),
        ProblemCode(
            "calibration_unmade",
            _FIELD,
            "The calibration is being made, or its job has failed.",
            "Wait for its job, or read the job's error.",
        ),
        ProblemCode(
            "calibration_unposed",
            (*_FIELD, "finding"),
            "The calibration has the intrinsics of its cameras, and no poses.",
            "Make one from videos in which the cameras see the board at the same time.",
        ),
        ProblemCode(
            "upload_unknown", _FIELD, "There is no such upload, or it was used or has expired.", "Send the file again."
        ),
        ProblemCode("upload_unfinished", _FIELD, "The upload is not complete.", "Send the rest of the file first."),
        ProblemCode("part_too_large", ("413",), "A file or part is larger than allowed.", "Send a smaller file."),
        ProblemCode(
            "session_too_large",
            ("413", "422", "command"),
            "The session's files, or the data read from them, are larger than the service accepts.",
            "Cut it into several sessions.",
        ),
        ProblemCode(
            "file_too_large", ("413",), "The upload was announced larger than allowed.", "Send a smaller file."
        ),
        ProblemCode("piece_too_large", ("413",), "The piece goes beyond the end of the upload.", "Send the rest only."),
        ProblemCode(
            "preflight_timeout",
            _FIELD,
            "The check of the files took too long.",
            "Send fewer or smaller files, or try again when the service is less busy.",
        ),
        ProblemCode(
            "frames_too_large",
            _FIELD,
            "The video's frames have more pixels than the operator allows.",
            "Lower the resolution of the video, and calibrate at that size.",
        ),
    ),
)
