"""Files that OpenCV itself writes."""

from pathlib import Path
from typing import Any

import cv2


def write_storage(path: Path, fields: dict[str, Any]) -> Path:
    """Write fields by OpenCV itself; dicts become maps."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    _write_map(storage, fields)
    storage.release()
    return path


def _write_map(storage: Any, fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        if isinstance(value, dict):
            storage.startWriteStruct(name, cv2.FileNode_MAP)
            _write_map(storage, value)
            storage.endWriteStruct()
        else:
            storage.write(name, value)
