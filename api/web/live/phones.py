"""Phones of recordings as cameras of live captures: their pictures go to the processes that decode them."""

import contextlib
import socket
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import replace

from api.web.dependencies import canonical_id
from api.web.live.connection import LiveConnection
from api.web.recordings.rooms import LiveTaker, Size
from pipeline.core.errors import listed_names
from pipeline.core.problems.finding_codes import CAMERA_SOURCE
from pipeline.run.live.cameras.sources import CameraSource
from worker.store.errors import NotFound
from worker.store.tenant_records import TenantRecords


class WrongSourceError(Exception):
    """A source of a camera can't be opened: code, message and hint."""


def require_phone(records: TenantRecords, source: str) -> None:
    """Require that a source, ``phone://RECORDING_ID/NUMBER``, is a phone of the tenant; raises ``WrongSourceError``."""
    try:
        recording_id, number = _parts(source)
        phones = records.recordings.get(recording_id).phones
    except NotFound:
        message, hint = "There is no such recording, or it has ended.", "Choose a phone of a recording."
        raise WrongSourceError(CAMERA_SOURCE, message, hint) from None
    known = {str(phone.number): phone.name for phone in phones if not phone.is_removed}
    if number not in known:
        names = listed_names([f"{one} ({name})" for one, name in known.items()])
        hint = f"Its phones are {names}." if known else "Let phones join it first."
        raise WrongSourceError(CAMERA_SOURCE, "The recording has no such phone.", hint)


@contextlib.asynccontextmanager
async def phones_taken(
    connection: LiveConnection, sources: Sequence[CameraSource], sizes_px: Mapping[str, Size]
) -> AsyncIterator[list[CameraSource]]:
    """Have pictures of phones taken during the block; the sources with the sockets that bring them.

    ``sizes_px``: sizes at which cameras were calibrated, by their names.
    """
    opened = list(sources)
    async with contextlib.AsyncExitStack() as held:
        for place, source in enumerate(sources):
            if source.kind != "phone":
                continue
            recording_id, number = _parts(source.address)
            # Packets are whole or are not sent at all, so that a decoder that is started again finds its place.
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            held.enter_context(ours)
            held.enter_context(theirs)
            room = await held.enter_async_context(connection.services.rooms.entered(connection.records, recording_id))
            held.enter_context(room.taking(LiveTaker(int(number), sizes_px.get(source.camera), ours)))
            opened[place] = replace(source, pictures=theirs.fileno())
        yield opened


def _parts(source: str) -> tuple[str, str]:
    """Id of the recording and number of the phone, as it was stated; raises ``NotFound`` for no id."""
    recording_id, _, number = source.partition("://")[2].partition("/")
    return canonical_id(recording_id, "recording"), number
