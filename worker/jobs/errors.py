"""Errors of the job store, in the store's words; what they mean over HTTP is the web API's business.

::

    JobStoreError            a sentence for a person
    ├── NotFound             there is no such session, job, result or artifact
    ├── Conflict             not in this state
    │   ├── NotFinished      results were asked of a job that is still at work
    │   ├── NoResults        results were asked of a job that failed or was canceled
    │   └── KeyBusy          the request of an idempotency key is being answered
    ├── KeyReused            an idempotency key came with another request
    ├── QuotaExceeded        the tenant has as much as it may have
    └── NewerDatabase        the database was written by a newer version of Multicap
    OSError
    └── ArtifactsUnavailable the artifact store does not answer, or refuses us
"""


class JobStoreError(Exception):
    """Base of what the store refuses."""


class NotFound(JobStoreError):  # noqa: N818 - a state of things, not a mishap
    """There is no such session, job, result or artifact."""


class Conflict(JobStoreError):  # noqa: N818
    """The job's or session's state does not allow it."""


class NotFinished(Conflict):
    """The job is still at work."""


class NoResults(Conflict):
    """The job has ended without results: ``state`` is its state, ``reason`` the error that it failed with, if any.

    ``retryable``: whether another attempt may succeed.
    """

    def __init__(self, state: str, reason: str | None, retryable: bool) -> None:
        self.state, self.reason, self.retryable = state, reason, retryable
        super().__init__(f"The job is {state} and has no results.")


class KeyBusy(Conflict):
    """The request of an idempotency key is being answered."""


class KeyReused(JobStoreError):  # noqa: N818
    """An idempotency key came with another request."""


class NewerDatabase(JobStoreError):  # noqa: N818
    """The database was written by a newer version of Multicap, whose schema this one does not know."""

    def __init__(self, schema: str) -> None:
        self.schema = schema
        super().__init__(
            f"This database was written by a newer version of Multicap (schema {schema}). "
            "Upgrade Multicap, or restore a backup made with this version."
        )


class ArtifactsUnavailable(OSError):  # noqa: N818
    """The artifact store does not answer, or refuses us."""


class QuotaExceeded(JobStoreError):  # noqa: N818
    """The tenant has as much as it may have of ``name``, a field of ``Quotas``."""

    def __init__(self, name: str, limit: int, used: int) -> None:
        self.name, self.limit, self.used = name, limit, used
        super().__init__(f"At most {limit} {name.replace('_', ' ')} are allowed here; there are {used}.")
