"""Characters of the user's own: send, list, read, download, change, delete."""

from fastapi import APIRouter, Request, Response, status
from starlette.concurrency import run_in_threadpool

from api.web.auth import RecordsDep
from api.web.characters import intake
from api.web.characters.schemas import CharacterChanges, CharacterOut, CharacterPage, CharacterSummaryOut
from api.web.contract.description import Resource, file_content, location, problems
from api.web.contract.schemas import ID
from api.web.dependencies import CharacterId, Cursor, Limit, Services, ServicesDep
from api.web.downloads import ConditionsDep, file_responses, send_file
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional, require_match
from api.web.http.idempotency import Answer, IdempotentRequest
from api.web.sessions.preflight import CharacterContents
from api.web.sessions.receiving import Creation, add_creation
from worker.store.model.character_records import Character
from worker.store.repositories.work.expiry import remove_files
from worker.store.tenant_records import TenantRecords

router = APIRouter(prefix="/v1/characters", tags=["characters"])
# A route that takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1/characters", tags=["characters"], route_class=SmallBodyRoute)

_FILE = file_content(intake.MEDIA_TYPES)


def _add(services: Services, idempotent: IdempotentRequest, checked: intake.CheckedCharacter) -> Answer:
    facts, bones = intake.stored_facts(checked.contents), intake.stored_bones(checked.contents)
    with intake.stored_character(services, checked) as (character_id, file), idempotent.records.transaction() as work:
        work.uploads.use(checked.upload_ids)
        character = work.characters.add(character_id, checked.name, file, facts, bones, checked.spec.bones)
        headers = {"Location": f"/v1/characters/{character.id}"}
        return idempotent.store(work, Answer(201, headers, CharacterOut.from_bones(character).model_dump_json()))


_CREATE = """\
Send a character: a file with a skeleton, onto which motion is retargeted.

The file is read and its bones are recognised at once. `bones` states those that are not recognised, or are recognised
wrong. Generated clients use `createCharacterFromFiles` and `createCharacterFromUploads`, which do the same with one
kind of body each.
"""
add_creation(
    router,
    "",
    "createCharacter",
    Creation(intake.CHARACTER_FORM, intake.check_character, _add),
    "Send a character",
    _CREATE,
    status_code=status.HTTP_201_CREATED,
    response_model=CharacterOut,
    responses={201: {"headers": {"Location": location("character")}}, **problems(400, 408, 409, 413, 415, 422, 507)},
)


@router.get("", summary="List characters", responses=problems(422))
def list_characters(records: RecordsDep, limit: Limit = 50, cursor: Cursor = None) -> CharacterPage:
    """List characters without their bones, the newest first."""
    found = records.characters.page(limit=limit, after=str(cursor) if cursor else None)
    next_cursor = found[-1].id if len(found) == limit else None
    return CharacterPage(
        characters=tuple(CharacterSummaryOut.from_character(character) for character in found), next_cursor=next_cursor
    )


@router.get(
    "/{character_id}",
    summary="Read a character",
    response_model=CharacterOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_character(character_id: CharacterId, records: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read a character: facts about its file, the bone of each joint and how it was recognised, and its skeleton."""
    return conditional(CharacterOut.from_bones(records.characters.get(character_id)), if_none_match)


@router.get(
    "/{character_id}/file",
    summary="Download a character",
    response_class=Response,
    responses={**file_responses(_FILE, redirect=f"characters/{ID}/file"), **problems(404, 410, 416)},
)
def get_character_file(
    character_id: CharacterId, request: Request, services: ServicesDep, records: RecordsDep, conditions: ConditionsDep
) -> Response:
    """Download the file of a character as it was sent, or a range of it."""
    return send_file(request, services, intake.character_download(records.characters.get(character_id)), conditions)


@small.patch(
    "/{character_id}",
    summary="Change a character",
    response_model=CharacterOut,
    responses={200: {"headers": ETAG}, **problems(400, 404, 409, 410, 412, 413, 415, 422, 507)},
)
async def change_character(
    character_id: CharacterId,
    changes: CharacterChanges,
    request: Request,
    services: ServicesDep,
    records: RecordsDep,
    if_match: IfMatch = None,
) -> Response:
    """Rename a character, or correct its bones, which are recognised again. With `If-Match`, only an unchanged one.

    Corrections replace earlier ones.
    """
    character = await run_in_threadpool(_matching, records, character_id, if_match)
    contents = None
    if changes.bones is not None:
        contents = await intake.check_again(services, request.state.caller.owner, character, changes.bones)
    changed = await run_in_threadpool(_change, records, character_id, changes, contents, if_match)
    return conditional(CharacterOut.from_bones(changed), None)


def _matching(records: TenantRecords, character_id: str, if_match: str | None) -> Character:
    """Read a character, in the version that the client has."""
    character = records.characters.get(character_id)
    if if_match is not None:
        require_match(CharacterOut.from_bones(character), if_match)
    return character


def _change(
    records: TenantRecords,
    character_id: str,
    changes: CharacterChanges,
    contents: CharacterContents | None,
    if_match: str | None,
) -> Character:
    with records.transaction() as work:
        character = _matching(work, character_id, if_match)
        if changes.name is not None:
            character = work.characters.rename(character_id, changes.name)
        if contents is not None and changes.bones is not None:
            character = work.characters.correct(
                character_id, intake.stored_facts(contents), intake.stored_bones(contents), changes.bones
            )
        return character


@router.delete(
    "/{character_id}", summary="Delete a character", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404)
)
def delete_character(character_id: CharacterId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a character and its file."""
    services.disk.using_reserve(lambda: records.characters.delete(character_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


CREATION = Resource(router=router, forms=(intake.CHARACTER_FORM,))
RESOURCE = Resource(router=small)
