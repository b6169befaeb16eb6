"""Characters of users."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, TypeVar

from sqlalchemy import Connection, Row, delete, insert, select, update

from worker.store.database.access import existing, newest_first
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.stored_files import StoringRepository, forget_answers, keep, remove_later
from worker.store.database.tables import characters
from worker.store.errors import Conflict
from worker.store.files.file_keys import character_prefix
from worker.store.model.character_records import Character, CharacterSummary, StoredCharacterFile
from worker.store.repositories.audit import AuditAction, record_event

CharacterT = TypeVar("CharacterT", bound=CharacterSummary)


class Characters(StoringRepository):
    """Characters of a tenant, or of all tenants."""

    _prefix = staticmethod(character_prefix)

    def add(
        self,
        character_id: str,
        name: str,
        file: StoredCharacterFile,
        facts: Mapping[str, Any],
        bones: Mapping[str, Any],
        corrections: Mapping[str, str | None],
    ) -> Character:
        """Add a character whose file is in the artifact store.

        ``character_id``: made by ``reserve_id``. ``facts``, ``bones``, ``corrections``: see
        ``worker.store.model.character_records.Character``. Raises ``QuotaExceeded``. Raises ``Conflict``: the file took
        more than a day to arrive, and was removed.
        """
        access, num_bytes = self._access, file.num_bytes + _json_bytes(bones)
        with access.writing() as connection:
            access.require_room(connection, stored_bytes=num_bytes)
            if not keep(connection, character_prefix(character_id)):
                raise Conflict("The character's file took too long to arrive; send it again.")
            connection.execute(
                insert(characters).values(
                    id=character_id,
                    tenant=access.owner,
                    name=name,
                    created_at=now(),
                    file=asdict(file),
                    facts=dict(facts),
                    bones=dict(bones),
                    corrections=dict(corrections),
                    num_bytes=num_bytes,
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.CHARACTER_CREATED, character_id)
            return read(Character, self._row(connection, character_id))

    def get(self, character_id: str) -> Character:
        """Character with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return read(Character, self._row(connection, character_id))

    def page(self, limit: int = 50, after: str | None = None) -> list[CharacterSummary]:
        """Characters, the newest first; ``after`` is the last id of the page before."""
        listed = (characters.c[field.name] for field in fields(CharacterSummary))
        query = newest_first(select(*listed).where(self._access.may_reach(characters)), characters, limit, after)
        with self._access.reading() as connection:
            return [read(CharacterSummary, row) for row in connection.execute(query)]

    def rename(self, character_id: str, name: str) -> Character:
        """Give a character another name; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            row = self._row(connection, character_id)
            if row.name != name:
                connection.execute(update(characters).where(characters.c.id == row.id).values(name=name))
                record_event(connection, self._access.actor, row.tenant, AuditAction.CHARACTER_RENAMED, row.id)
            return read(Character, self._row(connection, character_id))

    def correct(
        self,
        character_id: str,
        facts: Mapping[str, Any],
        bones: Mapping[str, Any],
        corrections: Mapping[str, str | None],
    ) -> Character:
        """Replace a user's corrections of a character's bones, and the bones recognised with them.

        Raises ``NotFound`` or ``QuotaExceeded``.
        """
        with self._access.writing() as connection:
            row = self._row(connection, character_id)
            num_bytes = row.file["num_bytes"] + _json_bytes(bones)
            self._access.require_room(connection, stored_bytes=max(0, num_bytes - row.num_bytes))
            values = {"facts": dict(facts), "bones": dict(bones), "corrections": dict(corrections)}
            chosen = update(characters).where(characters.c.id == row.id)
            connection.execute(chosen.values(**values, num_bytes=num_bytes))
            record_event(connection, self._access.actor, row.tenant, AuditAction.CHARACTER_CORRECTED, row.id)
            return read(Character, self._row(connection, character_id))

    def delete(self, character_id: str) -> None:
        """Delete a character, and note its file for removal; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            row = self._row(connection, character_id)
            remove_later(connection, character_prefix(row.id))
            forget_answers(connection, row.tenant, row.id)
            record_event(connection, self._access.actor, row.tenant, AuditAction.CHARACTER_DELETED, row.id)
            connection.execute(delete(characters).where(characters.c.id == row.id))

    def _row(self, connection: Connection, character_id: str) -> Row[Any]:
        query = select(characters).where(characters.c.id == character_id, self._access.may_reach(characters))
        return existing(connection.execute(query).one_or_none(), "character")


def _json_bytes(document: Mapping[str, Any]) -> int:
    return len(json.dumps(document))
