"""Keypoints of a live capture that are kept: a file of packets while it runs, an ordinary session at its end."""

import hashlib
import json
import subprocess
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import structlog
from starlette.concurrency import run_in_threadpool

from api.web.dependencies import Services
from api.web.http.bodies.form import Form, ReceivedFile
from api.web.http.bodies.form_kinds import CALIBRATION, KEYPOINTS, MANIFEST, TIMESTAMPS
from api.web.http.bodies.validation import NO_PLACES
from api.web.live.connection import LiveConnection
from api.web.live.problems import failed
from api.web.live.schemas import POINTS, Layout
from api.web.sessions.intake import check
from api.web.sessions.receiving import Sent
from api.web.sessions.schemas import SESSION_FORM
from api.web.sessions.storing import CheckedSession, stored
from pipeline.run.live.packets import KeypointsHead, framed
from worker.store.files.disk import append_whole, is_disk_full
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)

_BLOCK_BYTES = 2**20
# Files that the archive of a camera may have.
_MAX_FRAMES_OF_CAMERA = 500_000
# Layouts that are written as they are, and have as many points as others.
_STATED = frozenset({"coco-17", "coco-18", "body-25"})
# Several times the time of writing the files on one core.
_S_PER_BYTE = 1800 / 2**30
_START_S = 60.0


class KeptPackets:
    """Packets of a capture in a file, as many as a session may have and the disk takes.

    A capture whose disk is full continues; packets that were kept before stay. ``folder`` is the folder of the
    connection, which the caller removes.
    """

    def __init__(self, services: Services, folder: Path, layout: Layout) -> None:
        self._services, self._num_points, self.layout = services, POINTS[layout], layout
        self.path = folder / "packets"
        self.path.touch()
        self._buffer = bytearray()
        self._left_joints = services.settings.max_session_joints
        self._frames: Counter[int] = Counter()
        self._buffered: Counter[int] = Counter()  # Frames that are in memory alone
        self.is_full = False

    @property
    def num_frames(self) -> int:
        """Number of frames that are kept."""
        return self._frames.total()

    async def add(self, packet: bytes) -> None:
        """Keep a packet, unless a session can't have it or an earlier one, or the disk is full."""
        head = KeypointsHead.decode(packet)
        if head is None or self.is_full:
            return
        self._left_joints -= head.num_people * self._num_points
        if self._left_joints < 0 or self._frames[head.camera] >= _MAX_FRAMES_OF_CAMERA:
            self.is_full = True
            return
        self._frames[head.camera] += 1
        self._buffered[head.camera] += 1
        self._buffer += framed(packet)
        if len(self._buffer) >= _BLOCK_BYTES:
            await self.flush()

    async def flush(self) -> None:
        """Write what is in memory."""
        block, self._buffer = bytes(self._buffer), bytearray()
        buffered, self._buffered = self._buffered, Counter()
        try:
            await run_in_threadpool(self._write, block)
        except OSError as error:
            if not is_disk_full(error):
                raise
            self.is_full = True
            self._frames -= buffered
            _log.warning("live_keeping_stopped", reason="disk_full", kept_frames=self.num_frames)

    def _write(self, block: bytes) -> None:
        self._services.disk.require_room(len(block))
        append_whole(self.path, block)


async def keep_session(
    connection: LiveConnection, kept: KeptPackets, name: str, calibration: Path, cameras: Sequence[str]
) -> str:
    """Make a session of the kept keypoints, checked and stored like others; return its id.

    Raises ``ApiError`` with all that is wrong, such as a single frame.
    """
    await kept.flush()
    folder, services = calibration.parent, connection.services
    records, owner = connection.records, connection.caller.owner
    archives = await services.checks.run(owner, _write_files, services, kept.path, folder, cameras, kept.layout)
    manifest = {
        "name": name,
        **({"layout": kept.layout} if archives and kept.layout in _STATED else {}),
        "cameras": [{"name": camera, "file": archive} for camera, archive in archives.items()],
        "metadata": {"source": "live"},
    }
    files: dict[str, tuple[ReceivedFile, ...]] = {CALIBRATION: (_received(calibration),)}
    if archives:
        files[KEYPOINTS] = tuple(_received(folder / archive) for archive in archives.values())
        files[TIMESTAMPS] = (_received(folder / "timestamps.csv"),)
    num_bytes = sum(file.num_bytes for of_part in files.values() for file in of_part)
    await run_in_threadpool(records.require_room, num_bytes)
    form = Form(files, {MANIFEST: json.dumps(manifest).encode()}, ())
    checked = await check(owner, services, records, Sent(folder, SESSION_FORM, form, None, NO_PLACES))
    return await run_in_threadpool(_store, services, records, checked)


def _write_files(
    services: Services, packets: Path, folder: Path, cameras: Sequence[str], layout: str
) -> dict[str, str]:
    """Write archives and times by a child process; return the names of the archives by camera."""
    services.disk.require_room(packets.stat().st_size)
    command = [*services.settings.live_keeping_command, str(packets), str(folder), json.dumps(cameras), layout]
    timeout_s = _START_S + packets.stat().st_size * _S_PER_BYTE
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout_s, check=True)  # noqa: S603 - the command is the operator's
    except subprocess.SubprocessError as error:
        log = (getattr(error, "stderr", None) or b"")[-4000:].decode(errors="replace")
        _log.exception("live_not_kept", log=log)
        raise failed() from None
    names: dict[str, str] = json.loads(done.stdout)
    return names


def _received(path: Path) -> ReceivedFile:
    with path.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    return ReceivedFile(path.name, path, path.stat().st_size, digest)


def _store(services: Services, records: TenantRecords, checked: CheckedSession) -> str:
    with stored(services, checked) as new, records.transaction() as work:
        return new.add_to(work).id
