"""Links that open something of a job without a key."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "links",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("key_id", sa.String(36)),
        sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("name", sa.String),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_links"),
        sa.UniqueConstraint("sha256", name="uq_links_sha256"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_links_job_id", ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["key_id"], ["keys.id"], name="fk_links_key_id", ondelete="CASCADE"),
    )
    op.create_index("ix_links_job_id", "links", ["job_id"])
    op.create_index("ix_links_expires_at", "links", ["expires_at"])


def downgrade() -> None:
    """Forget the links."""
    op.drop_table("links")
