"""Recordings by phones: their phones, takes and clips, and the phone of an upload."""

import sqlalchemy as sa
from alembic import op

revision = "0037"
down_revision = "0036"


def upgrade() -> None:
    """Create the tables; uploads so far are those of keys."""
    op.create_table(
        "recordings",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("join_id", sa.String(36), nullable=False),
        sa.Column("join_sha256", sa.String(64), nullable=False),
        sa.Column("join_key_id", sa.String(36)),
        sa.PrimaryKeyConstraint("id", name="pk_recordings"),
        sa.UniqueConstraint("join_sha256", name="uq_recordings_join_sha256"),
    )
    op.create_index("ix_recordings_expires_at", "recordings", ["expires_at"])
    op.create_index("ix_recordings_tenant_id", "recordings", ["tenant", "id"])
    op.create_table(
        "phones",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("device", sa.String(100), nullable=False),
        sa.Column("joined_at", sa.Double, nullable=False),
        sa.Column("removed_at", sa.Double),
        sa.PrimaryKeyConstraint("recording_id", "number", name="pk_phones"),
        sa.UniqueConstraint("recording_id", "sha256", name="uq_phones_recording_id_sha256"),
        _of_recording("phones"),
    )
    op.create_table(
        "takes",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("start_s", sa.Double, nullable=False),
        sa.Column("stop_s", sa.Double, nullable=False),
        sa.Column("is_stopped", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("settings", sa.JSON, nullable=False),
        sa.Column("is_upload_wanted", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("is_discarded", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("session_id", sa.String(36)),
        sa.Column("job_id", sa.String(36)),
        sa.Column("calibration_id", sa.String(36)),
        sa.PrimaryKeyConstraint("recording_id", "number", name="pk_takes"),
        _of_recording("takes"),
    )
    op.create_table(
        "clips",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("take", sa.Integer, nullable=False),
        sa.Column("phone", sa.Integer, nullable=False),
        sa.Column("started", sa.JSON),
        sa.Column("stopped", sa.JSON),
        sa.Column("files", sa.JSON, nullable=False),
        sa.PrimaryKeyConstraint("recording_id", "take", "phone", name="pk_clips"),
        _of_recording("clips"),
    )
    op.add_column("uploads", sa.Column("recording_id", sa.String(36)))
    op.add_column("uploads", sa.Column("phone", sa.Integer))
    op.create_index("ix_uploads_recording_id", "uploads", ["recording_id"])


def downgrade() -> None:
    """Drop the tables, and forget which phones uploads are from."""
    op.drop_index("ix_uploads_recording_id", "uploads")
    op.drop_column("uploads", "phone")
    op.drop_column("uploads", "recording_id")
    for table in ("clips", "takes", "phones", "recordings"):
        op.drop_table(table)


def _of_recording(table: str) -> sa.ForeignKeyConstraint:
    name = f"fk_{table}_recording_id"
    return sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name=name, ondelete="CASCADE")
