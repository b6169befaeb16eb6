"""Space for a new job: a reconstruction that is foreseen to fill the disk is refused before it is queued."""

from api.web.dependencies import Services
from api.web.errors import ApiError
from pipeline.capture.preflight_record import Preflight
from pipeline.core.problems.requests import SPACE_MISSING
from pipeline.run.space import foreseen_space, shown_bytes
from worker.store.model.characters import JobCharacter
from worker.store.model.jobs import config_of
from worker.store.spec import JobSpec


def require_space(services: Services, preflight: Preflight, spec: JobSpec, character: JobCharacter | None) -> None:
    """Raise ``ApiError`` if the disk has less space than a reconstruction needs; of a bucket nothing is known.

    The space that workers need meanwhile is on their own disks.
    """
    if services.settings.artifacts_url:
        return
    character_bytes = 0 if character is None else character.file.num_bytes
    needed_bytes = foreseen_space(preflight, config_of(spec), character_bytes).store_bytes
    if services.disk.has_room(needed_bytes):
        return
    free_bytes = max(0, services.disk.free_bytes - services.disk.headroom_bytes)
    raise ApiError(
        SPACE_MISSING,
        f"The job needs about {shown_bytes(needed_bytes)}, and the service's disk has {shown_bytes(free_bytes)}.",
        hint="Delete sessions that are no longer needed, ask for fewer files, or reconstruct fewer frames at a time "
        "by frame_range.",
        retryable=True,
    )
