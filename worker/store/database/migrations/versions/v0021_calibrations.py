"""Calibrations as a resource, and the jobs and sessions that make them."""

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"


def upgrade() -> None:
    """Add the table and the columns; earlier jobs reconstruct, and earlier sessions are captures."""
    op.create_table(
        "calibrations",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("method", sa.String(16), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("source", sa.JSON, nullable=False),
        sa.Column("files", sa.JSON(none_as_null=True)),
        sa.Column("report", sa.JSON(none_as_null=True)),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("session_id", sa.String(36)),
    )
    op.create_index("ix_calibrations_tenant_id", "calibrations", ["tenant", "id"])
    op.create_index("ix_calibrations_session_id", "calibrations", ["session_id"])
    op.add_column("jobs", sa.Column("making", sa.JSON(none_as_null=True)))
    op.add_column("sessions", sa.Column("purpose", sa.String(16), nullable=False, server_default="capture"))


def downgrade() -> None:
    """Forget the calibrations, and what only makes them."""
    op.execute("DELETE FROM jobs WHERE making IS NOT NULL")
    op.execute("DELETE FROM sessions WHERE purpose != 'capture'")
    op.drop_column("sessions", "purpose")
    op.drop_column("jobs", "making")
    op.drop_index("ix_calibrations_session_id", "calibrations")
    op.drop_index("ix_calibrations_tenant_id", "calibrations")
    op.drop_table("calibrations")
