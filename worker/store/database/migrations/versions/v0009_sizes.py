"""Size of the files of a session."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add the column, and fill it from what is known of the files."""
    op.add_column("sessions", sa.Column("num_bytes", sa.BigInteger, nullable=False, server_default="0"))
    sessions = sa.table("sessions", sa.column("id"), sa.column("files", sa.JSON), sa.column("num_bytes"))
    connection = op.get_bind()
    for row in connection.execute(sa.select(sessions.c.id, sessions.c.files)).all():
        num_bytes = sum(file["num_bytes"] for file in row.files)
        connection.execute(sa.update(sessions).where(sessions.c.id == row.id).values(num_bytes=num_bytes))


def downgrade() -> None:
    """Forget the sums."""
    op.drop_column("sessions", "num_bytes")
