"""Answers of idempotency keys as one JSON object, whose content is the web API's business."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"

_COMMON = ("tenant", "key", "fingerprint", "token", "claimed_until", "expires_at")
_ANSWER = ("status", "headers", "body")


def _table(name: str, *answer: "sa.Column[object]") -> sa.Table:
    return op.create_table(
        name,
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("key", sa.String(200), nullable=False),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("token", sa.String(36), nullable=False),
        sa.Column("claimed_until", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        *answer,
        sa.PrimaryKeyConstraint("tenant", "key", name=f"pk_{name}"),
    )


def upgrade() -> None:
    """Keep answers: clients may send their requests again after the upgrade."""
    table = _table("idempotency_keys", sa.Column("answer", sa.JSON(none_as_null=True)))
    op.create_index("ix_idempotency_keys_expires_at", "idempotency_keys", ["expires_at"])
    for row in op.get_bind().execute(sa.text("SELECT * FROM receipts")).mappings().all():
        headers = json.loads(row["headers"]) if isinstance(row["headers"], str) else row["headers"]
        answer = None if row["status"] is None else {**{name: row[name] for name in _ANSWER}, "headers": headers}
        op.get_bind().execute(table.insert().values(**{name: row[name] for name in _COMMON}, answer=answer))
    op.drop_table("receipts")


def downgrade() -> None:
    """Put the answers back into columns."""
    table = _table(
        "receipts",
        sa.Column("status", sa.Integer),
        sa.Column("headers", sa.JSON(none_as_null=True)),
        sa.Column("body", sa.String),
    )
    op.create_index("ix_receipts_expires_at", "receipts", ["expires_at"])
    for row in op.get_bind().execute(sa.text("SELECT * FROM idempotency_keys")).mappings().all():
        answer = json.loads(row["answer"]) if isinstance(row["answer"], str) else row["answer"] or {}
        values = {name: row[name] for name in _COMMON} | {name: answer.get(name) for name in _ANSWER}
        op.get_bind().execute(table.insert().values(**values))
    op.drop_table("idempotency_keys")
