"""Errors of the job store. The web API decides how it answers them (``api.web.errors``).

::

    JobStoreError            a sentence for a person
    ├── NotFound             there is no such session, job, result or artifact
    ├── Conflict             not in this state
    │   ├── NotFinished      a job without results yet
    │   ├── NoResults        a job that failed or was canceled has no results
    │   ├── PhoneRemoved     the host has removed the phone of a recording
    │   ├── EditedMeanwhile  the job has another revision than the caller knows
    │   ├── VideosDeleted    the session's videos were deleted, and the work needs them
    │   └── KeyBusy          the request of an idempotency key is at work
    ├── KeyReused            an idempotency key came with another request
    ├── QuotaExceeded        the tenant would exceed a quota
    ├── UnknownSchema        the database was written by a newer version of Multicap, or before the first release
    ├── DamagedDatabase      the database's file can't be read (a SQLAlchemyError too)
    └── DamagedArtifact      a stored file does not have its SHA-256
    OSError
    ├── ArtifactsUnavailable the artifact store does not respond: an outage (``worker.store.outages``)
    └── ArtifactsRefused     the artifact store refuses its keys, or has no such bucket
"""

import shlex
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError


class JobStoreError(Exception):
    """Base of the errors of the job store."""


class NotFound(JobStoreError):  # noqa: N818 - a state, not a failure
    """There is no such session, job, result or artifact."""


class Conflict(JobStoreError):  # noqa: N818
    """The job's or session's state does not allow it."""


class NotFinished(Conflict):
    """The job is still at work."""


class NoResults(Conflict):
    """The job has ended without results.

    ``state`` is the job's state, ``reason`` the error that it failed with, if any; ``retryable``: another attempt may
    succeed.
    """

    def __init__(self, state: str, reason: str | None, retryable: bool) -> None:
        self.state, self.reason, self.retryable = state, reason, retryable
        super().__init__(f"The job is {state} and has no results.")


class EditedMeanwhile(Conflict):
    """The edits of the session's people were changed after the caller read them."""

    def __init__(self, revision: int, known: int) -> None:
        super().__init__(f"The edits have the revision {revision} now, not {known}.")


class VideosDeleted(Conflict):
    """The session's videos were deleted, and the work needs them."""

    def __init__(self) -> None:
        super().__init__("The videos of this capture were deleted, and this needs them.")


class PhoneRemoved(Conflict):
    """The host has removed the phone of a recording."""

    def __init__(self) -> None:
        super().__init__("The host has removed this phone.")


class KeyBusy(Conflict):
    """The request of an idempotency key is at work."""


class KeyReused(JobStoreError):  # noqa: N818
    """An idempotency key came with another request."""


class UnknownSchema(JobStoreError):  # noqa: N818
    """The database has an unknown schema: of a newer version, or of one before the first release."""

    def __init__(self, schema: str, is_newer: bool) -> None:
        self.schema = schema
        super().__init__(
            f"This database was written by a newer version of Multicap (schema {schema}). "
            "Upgrade Multicap, or restore a backup made with this version."
            if is_newer
            else f"This database was written by Multicap before its first release (schema {schema}), "
            "and can't be upgraded. Start with an empty data folder or database."
        )


class DamagedDatabase(JobStoreError, SQLAlchemyError):  # noqa: N818
    """The file of a SQLite database can't be read. ``reason`` is SQLite's message."""

    def __init__(self, path: Path, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"The database {path} is damaged: {reason}.")

    def instructions(self) -> str:
        """Instructions for the operator: sentences and commands, one a line."""
        folder, restored = self.path.parent, self.path.parent.with_name(f"{self.path.parent.name}-restored")
        aside = folder / "damaged"
        database, quoted = shlex.quote(str(self.path)), shlex.quote(str(aside))
        return "\n".join(
            [
                "Stop the service and set the database aside, with all files that belong to it:",
                f"    mkdir {quoted} && mv {database}* {quoted}/",
                "With a backup, restore it into a new folder and start there:",
                f"    multicap backup restore BACKUP.tar --data {shlex.quote(str(restored))}",
                f"    multicap serve --data {shlex.quote(str(restored))}",
                "Without one, start empty: sessions, jobs and keys are gone then.",
                f"    multicap serve --data {shlex.quote(str(folder))}",
            ]
        )


class DamagedArtifact(JobStoreError):  # noqa: N818
    """A stored file, at ``key`` of the artifact store, does not have the SHA-256 of its row."""

    def __init__(self, key: str) -> None:
        self.key = key
        super().__init__(f"The stored file {key} is damaged.")


class ArtifactsUnavailable(OSError):  # noqa: N818
    """The artifact store does not respond, is overloaded, or broke off."""


class ArtifactsRefused(OSError):  # noqa: N818
    """The artifact store responds, and refuses: the keys are wrong, or the bucket is missing."""


class QuotaExceeded(JobStoreError):  # noqa: N818
    """The tenant would exceed the quota ``name``, a field of ``Quotas``."""

    def __init__(self, name: str, limit: int, used: int) -> None:
        self.name, self.limit, self.used = name, limit, used
        super().__init__(f"At most {limit} {name.replace('_', ' ')} are allowed here; there are {used}.")
