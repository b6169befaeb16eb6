"""What a deletion leaves: files to be removed from the artifact store, and kept answers that name what is gone."""

from datetime import timedelta

from sqlalchemy import Connection, Text, cast, delete, insert

from worker.store.database.connection import now
from worker.store.database.tables import idempotency_keys, removals

# Files of a session take less than this to reach the artifact store; a session that is not added by then never is.
_ARRIVAL = timedelta(days=1)
# A worker that was frozen while its job ended or was deleted may still write: look again when no such worker can be
# left.
_AGAIN_AFTER = timedelta(hours=2)


def remove_later(connection: Connection, prefix: str) -> None:
    """Note files to be removed after the transaction: all under a prefix, or one by its key."""
    for wait_s in (0.0, _AGAIN_AFTER.total_seconds()):
        connection.execute(insert(removals).values(prefix=prefix, due_at=now() + wait_s))


def remove_unless_kept(connection: Connection, prefix: str) -> None:
    """Note files that are about to be stored to be removed after a day, unless ``keep`` is called before."""
    connection.execute(insert(removals).values(prefix=prefix, due_at=now() + _ARRIVAL.total_seconds()))


def keep(connection: Connection, prefix: str) -> bool:
    """Delete the removals of some files; ``False`` if the files are removed already."""
    return connection.execute(delete(removals).where(removals.c.prefix == prefix)).rowcount > 0


def forget_answers(connection: Connection, tenant: str, record_id: str) -> None:
    """Forget the idempotency keys of a tenant whose answers have the id of a deleted record: they have its name too."""
    answer = cast(idempotency_keys.c.answer, Text)
    is_answered = (idempotency_keys.c.tenant == tenant) & answer.contains(record_id)
    connection.execute(delete(idempotency_keys).where(is_answered))
