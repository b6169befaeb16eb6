"""Tenants, keys, and browser sessions."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Make the tables; what is there belongs to the tenant ``default``, as everything does without keys."""
    for table in ("sessions", "jobs"):
        op.add_column(table, sa.Column("tenant", sa.String(64), nullable=False, server_default="default"))
        op.create_index(f"ix_{table}_tenant_id", table, ["tenant", "id"])
    op.create_table(
        "keys",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.Column("revoked_at", sa.Double),
        sa.PrimaryKeyConstraint("id", name="pk_keys"),
        sa.UniqueConstraint("sha256", name="uq_keys_sha256"),
    )
    op.create_table(
        "browser_sessions",
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("key_id", sa.String(36), nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.ForeignKeyConstraint(["key_id"], ["keys.id"], name="fk_browser_sessions_key_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("sha256", name="pk_browser_sessions"),
    )


def downgrade() -> None:
    """Forget the keys; everything belongs to everybody again."""
    op.drop_table("browser_sessions")
    op.drop_table("keys")
    for table in ("jobs", "sessions"):
        op.drop_index(f"ix_{table}_tenant_id", table)
        op.drop_column(table, "tenant")
