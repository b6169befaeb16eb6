"""Schema of the first release.

The number continues from unreleased schemas, so that their databases are told apart. Until the first release its schema
is the tables' own: a second revision needs this one written out, as ``alembic revision --autogenerate`` writes it.
"""

from alembic import op

from worker.store.database.tables import metadata

revision = "0041"
down_revision = None


def upgrade() -> None:
    """Make the tables; a database without a revision that has one of them is not Multicap's."""
    metadata.create_all(op.get_bind(), checkfirst=False)
