"""Sources of cameras as users state them: addresses of streams, devices and files."""

import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CAMERA_SOURCE
from pipeline.core.problems.session_codes import VIDEO_MISSING

SourceKind = Literal["rtsp", "http", "device", "file", "phone"]
"""Kind of a source. A file is played at its own pace; a phone's pictures come from the service."""

SCHEMES: dict[str, SourceKind] = {"rtsp": "rtsp", "rtsps": "rtsp", "http": "http", "https": "http"}
"""Kind of a source by the scheme of its address."""
REPEATED_SOURCE = "The source is another camera's already."
_HINT = "Write it as cam_1=rtsp://192.168.0.10/stream, cam_2=http://..., cam_3=/dev/video0 or cam_4=clip.mp4."


@dataclass(frozen=True, slots=True)
class CameraSource:
    """Source of a camera's pictures."""

    camera: str  # Name of the camera
    kind: SourceKind
    address: str  # Address with user and password, if there are any, or path
    host: str | None = None  # Host and port of the address, where it has a checked IP address in their place
    pictures: int | None = None  # Open socket that brings the packets of a phone's pictures

    @property
    def shown(self) -> str:
        """Address for people, without user and password; of a file or device its base name."""
        if self.kind in {"device", "file"}:
            return Path(self.address).name
        url = urlsplit(self.address)
        return url._replace(netloc=self.host or url.netloc.rpartition("@")[2], query="").geturl()


def read_sources(texts: Sequence[str], cameras: Sequence[str]) -> list[CameraSource]:
    """Read what was stated as ``CAMERA=SOURCE``.

    ``cameras``: names of the calibrated cameras. Raises ``InputError``: with everything that is wrong: malformed texts,
    unknown and repeated cameras, missing files, fewer than two cameras.
    """
    problems: list[Problem] = []
    sources: list[CameraSource] = []
    for text in texts:
        name, sign, address = (part.strip() for part in text.partition("="))
        if not (name and sign and address):
            problems.append(Problem(CAMERA_SOURCE, f"{text!r} is not CAMERA=SOURCE.", field="camera", hint=_HINT))
            continue
        found = [*name_problems(name, cameras, [source.camera for source in sources]), *_address_problems(address)]
        problems += (Problem(code, message, camera=name, hint=hint) for code, message, hint in found)
        if address in {source.address for source in sources}:
            problems.append(Problem(CAMERA_SOURCE, REPEATED_SOURCE, camera=name, hint="Give each camera its own."))
        sources.append(CameraSource(name, _kind(address) or "file", address))
    if len(texts) < 2:
        message, hint = "A live capture needs at least two cameras.", "Give --camera for each of them."
        problems.append(Problem(CAMERA_SOURCE, message, field="camera", hint=hint))
    if problems:
        raise InputError(problems)
    return sources


def _kind(address: str) -> SourceKind | None:
    """Kind of a source; ``None`` for a scheme that is not supported."""
    scheme, sign, _ = address.partition("://")
    if sign:
        return SCHEMES.get(scheme.lower())
    try:
        return "device" if stat.S_ISCHR(os.stat(address).st_mode) else "file"  # noqa: PTH116 - of a text
    except (OSError, ValueError):
        return "device" if address.startswith("/dev/") else "file"


def name_problems(name: str, cameras: Sequence[str], earlier: Sequence[str]) -> Iterator[tuple[Code, str, str]]:
    """Find out whether a camera is unknown, or has a source already: code, message and hint of each problem."""
    if name not in cameras:
        hint = f"Its cameras are {listed_names(cameras)}."
        yield CAMERA_SOURCE, "The calibration has no camera of this name.", hint
    if name in earlier:
        yield CAMERA_SOURCE, "The camera is stated twice.", "State each camera once."


def _address_problems(address: str) -> Iterator[tuple[Code, str, str]]:
    kind = _kind(address)
    if kind is None:
        scheme = address.partition("://")[0]
        yield unsupported(scheme)
    elif kind in {"device", "file"} and not Path(address).exists():
        noun = "device" if kind == "device" else "file"
        yield VIDEO_MISSING, f"There is no {noun} {Path(address).name}.", "Check the path."


def unsupported(scheme: str) -> tuple[Code, str, str]:
    """Problem of an address of a scheme without streams: code, message and hint."""
    return CAMERA_SOURCE, f"Streams of {scheme}:// are not supported.", "Use rtsp, rtsps, http or https."


def find_devices(folder: Path = Path("/sys/class/video4linux")) -> dict[str, str]:
    """Names of this machine's cameras, by their devices; none on systems other than Linux.

    A camera has several devices, of which the one with index 0 gives pictures.
    """
    found = {}
    for entry in sorted(folder.glob("video*")):
        try:
            if int((entry / "index").read_text()) == 0:
                found[f"/dev/{entry.name}"] = (entry / "name").read_text().strip()
        except (OSError, ValueError):  # it was unplugged
            continue
    return found
