"""Intake of characters: their form, the check of the file, and its way to the artifact store."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from api.web.characters.schemas import CharacterSpec, UploadedCharacter
from api.web.dependencies import Services
from api.web.downloads import Download, damaged_file, missing_file
from api.web.errors import ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.form import ReceivedFile
from api.web.http.bodies.form_kinds import CHARACTER, SPEC, FormKind
from api.web.sessions import preflight
from api.web.sessions.receiving import Sent, spool_folder, with_spec
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import MISSING_PART
from pipeline.core.problems.session_codes import BONES_INVALID
from worker.store.errors import DamagedArtifact, NotFound
from worker.store.files.file_keys import character_key, character_prefix
from worker.store.model.character_records import Character, StoredCharacterFile
from worker.store.outages import undo_on_failure
from worker.store.tenant_records import TenantRecords

MEDIA_TYPES = ("model/gltf-binary", "application/octet-stream")
"""Media types of characters' files: of GLB and VRM, and of FBX, which has none of its own."""
_BONES, _FBX = "bones", "FBX"


@dataclass(frozen=True, slots=True)
class CheckedCharacter:
    """A character without errors whose file is not in the artifact store yet."""

    spec: CharacterSpec
    file: ReceivedFile
    contents: preflight.CharacterContents
    upload_ids: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name for people."""
        return self.spec.name or self.file.name


async def check_character(owner: str, services: Services, records: TenantRecords, sent: Sent) -> CheckedCharacter:
    """Check a character: its file and the corrections of its bones. Raises ``ApiError``: with all that is wrong."""
    form, spec, part, errors = await with_spec(owner, services, records, sent, CharacterSpec)
    if spec is None or errors:
        raise unprocessable(errors)
    pointer = pointer_to(*filter(None, (part, _BONES)))
    (file,) = form.files[CHARACTER]
    wait_s = preflight.character_wait_s(file.num_bytes)
    try:
        contents = await services.checks.run(
            owner, services.preflight.read_character, file.path, spec.bones, sent.folder, further_wait_s=wait_s
        )
    except preflight.InvalidFilesError as invalid:
        raise unprocessable([_located(item, pointer, pointer_to(CHARACTER)) for item in invalid.errors]) from None
    return CheckedCharacter(spec, file, contents, sent.upload_ids)


@contextlib.contextmanager
def stored_character(services: Services, checked: CheckedCharacter) -> Iterator[tuple[str, StoredCharacterFile]]:
    """Put the file of a character into the artifact store; the block records the character under the id.

    If the block fails, the file is removed; else the file of its upload is. The reaper removes the file of a process
    that is killed in between, and of a transaction whose answer was lost, if it was not committed.
    """
    character_id = services.store.characters.reserve_id()
    sent, key = checked.file, character_key(character_id)
    with undo_on_failure() as undo:
        undo.callback(services.artifacts.delete_prefix, character_prefix(character_id))
        services.artifacts.put_file(key, sent.path)
        yield character_id, StoredCharacterFile(sent.name, key, sent.num_bytes, sent.sha256)
    for upload_id in checked.upload_ids:
        services.uploads.remove(upload_id)


async def check_again(
    services: Services, owner: str, character: Character, corrections: Mapping[str, str | None]
) -> preflight.CharacterContents:
    """Recognise the bones of a stored character again, with other corrections.

    Raises ``ApiError``: with all that is wrong with the corrections; or if the file is missing or damaged.
    """
    async with spool_folder(services.settings.spool_dir) as folder:
        try:
            return await services.checks.run(
                owner,
                _read_stored,
                services,
                character,
                corrections,
                folder,
                further_wait_s=preflight.character_wait_s(character.file.num_bytes),
            )
        except preflight.InvalidFilesError as invalid:
            pointer = pointer_to(_BONES)
            raise unprocessable([_located(item, pointer, pointer) for item in invalid.errors]) from None


def character_download(character: Character) -> Download:
    """File of a character as it was sent."""
    file, media_type = character.file, MEDIA_TYPES[character.facts.get("format") == _FBX]
    return Download(file.name, media_type, file.key, file.num_bytes, file.sha256, remedy="Send the character again.")


def stored_facts(contents: preflight.CharacterContents) -> dict[str, object]:
    """Facts that lists show, as they are stored."""
    return contents.model_dump(mode="json", include=set(preflight.CharacterFacts.model_fields))


def stored_bones(contents: preflight.CharacterContents) -> dict[str, object]:
    """Bones and skeleton, as they are stored."""
    return contents.model_dump(mode="json", include=set(preflight.CharacterBones.model_fields))


def _read_stored(
    services: Services, character: Character, corrections: Mapping[str, str | None], folder: Path
) -> preflight.CharacterContents:
    try:
        with services.artifacts.local_path(character.file.key, character.file.sha256) as path:
            return services.preflight.read_character(path, corrections, folder)
    except NotFound:
        raise missing_file(character_download(character)) from None
    except DamagedArtifact as error:
        raise damaged_file(character_download(character)) from error


def _located(item: ErrorItem, bones: str, character: str) -> ErrorItem:
    """Add the pointer of a problem: to the corrections, or to the file, whose name only the client knows."""
    is_of_bones = item.code == BONES_INVALID
    return item.model_copy(
        update={"pointer": bones if is_of_bones else character, "file": None if is_of_bones else item.file}
    )


def _faults(counts: Mapping[str, int]) -> Iterator[tuple[Code, str, str]]:
    if not counts[CHARACTER]:
        yield MISSING_PART, "There is no character: send its file, GLB, VRM or FBX.", CHARACTER


CHARACTER_FORM = FormKind(
    name="CharacterForm",
    noun="character",
    parts={CHARACTER: "File of the character: GLB (binary glTF 2.0) or VRM with everything inside, or binary FBX 7."},
    documents={SPEC: CharacterSpec},
    uploaded=UploadedCharacter,
    faults=_faults,
)
