"""Tries of chunks that cost their workers, progress of running chunks, and the turns of tenants."""

import sqlalchemy as sa
from alembic import op

revision = "0040"
down_revision = "0039"


def upgrade() -> None:
    """Add the columns and the table; no chunk has lost a try so far."""
    op.add_column("chunks", sa.Column("moved_at", sa.Double))
    op.add_column("chunks", sa.Column("lost_tries", sa.Integer, nullable=False, server_default="0"))
    op.add_column("chunks", sa.Column("due_at", sa.Double))
    is_lost = sa.text("lost_tries > 0")
    op.create_index("ix_chunks_lost_tries", "chunks", ["state"], sqlite_where=is_lost, postgresql_where=is_lost)
    op.create_table(
        "turns",
        sa.Column("tenant", sa.String(64), primary_key=True),
        sa.Column("claimed_at", sa.Double, nullable=False),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("turns")
    op.drop_index("ix_chunks_lost_tries", "chunks")
    for name in ("due_at", "lost_tries", "moved_at"):
        op.drop_column("chunks", name)
