"""Files of the user's own networks: added after a check, listed, and read as entries of the registry."""

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.core.errors import ModelError
from pipeline.core.layouts import LAYOUTS
from pipeline.core.runtime.confinement import BeyondLimitsError, ChildLimits, run_confined
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, storage_errors, write_file
from pipeline.detection.own_network import OwnNetwork, decode_description, encode_description
from pipeline.detection.registry import LooseWeights, NetworkEntry, NetworkHead, NetworkInput

OWN_PREFIX = "own-"
UNKNOWN_LICENCE = "unknown"
_NAME = re.compile(r"own-[a-z0-9]+(?:-[a-z0-9]+)*-[0-9a-f]{12}")
_MAX_BYTES = 2**30
_MAX_INPUT_PX = 2048
_TIMEOUT_S = 60.0
# Beside the start of the process; networks of a profile take less than a second for an image.
_MAX_CPU_S = 10
_MAX_MEMORY_BYTES = 6 * 2**30
_NUM_NAME = 40


def add_own(path: Path, network: OwnNetwork, has_chosen_size: bool = True) -> str:
    """Check an ONNX file, and copy it to the folder of models with its description.

    ``has_chosen_size``: whether the size of the input must be the description's; otherwise a fixed size of the file
    counts. Returns name of the network as a detector: ``own-NAME-DIGEST``. The digest is computed from the file and its
    description. Raises ``ModelError`` if the file can't be read or used; the message names it, and says what to do.
    """
    if max(network.input_px) > _MAX_INPUT_PX or min(network.input_px) < 1:
        raise ModelError(f"The sides of an input have 1 to {_MAX_INPUT_PX} pixels; see --input-size.")
    folder = home() / "models"
    with storage_errors():
        folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".own-") as scratch:
        # A copy, so that the checked file is the added file.
        copy = Path(scratch) / "network.onnx"
        _copy(path, copy)
        arguments = [str(copy), *map(str, network.input_px)]
        limits, task = ChildLimits(_MAX_CPU_S, _MAX_MEMORY_BYTES), f"check of {path.name}"
        try:
            output = run_confined(
                "pipeline.detection.own.check_network", arguments, limits, task=task, timeout_s=_TIMEOUT_S
            )
        except BeyondLimitsError as error:
            if error.is_time:
                raise _endless(path.name) from error
            raise ModelError(f"{path.name} can't be used: its check took too much memory.") from error
        shapes: dict[str, Any] = json.loads(output)
        if "problem" in shapes:
            raise ModelError(f"{path.name} can't be used: {shapes['problem']}.")
        network = _with_size(network, shapes["input"], has_chosen_size, path.name)
        _check_outputs(network, list(shapes["outputs"].values()), path.name)
        content, description = copy.read_bytes(), encode_description(network)
    digest = hashlib.sha256(content + description).hexdigest()[:12]
    slug = re.sub(r"[^a-z0-9]+", "-", path.stem.lower())[:_NUM_NAME].strip("-") or "network"
    name = f"{OWN_PREFIX}{slug}-{digest}"
    target = folder / f"{name}.onnx"
    with exclusive(target):
        write_file(target.with_suffix(".json"), description)
        write_file(target, content)
    return name


def own_names() -> tuple[str, ...]:
    """Names of the networks that were added, sorted."""
    return tuple(sorted(path.stem for path in (home() / "models").glob("own-*.onnx") if _NAME.fullmatch(path.stem)))


def own_entry(name: str) -> NetworkEntry:
    """Entry of a network that was added.

    Raises ``ModelError`` if there is no such network, or its files were changed.
    """
    path = home() / "models" / f"{name}.onnx"
    if not _NAME.fullmatch(name) or not path.is_file():
        raise ModelError(f"There is no network {name!r}. Add its file: multicap models add FILE --head HEAD ...")
    with storage_errors():
        description = path.with_suffix(".json")
        own = decode_description(description.read_bytes(), description.name)
        sha256, num_bytes = file_sha256(path), path.stat().st_size
        digest = hashlib.sha256(path.read_bytes() + encode_description(own)).hexdigest()[:12]
    if not name.endswith(digest):
        raise ModelError(f"The file of the network {name} was changed. Add it again: multicap models add FILE ...")
    return NetworkEntry(
        name=name,
        source=LooseWeights(()),
        convert=b"".join,
        sha256=sha256,
        num_bytes=num_bytes,
        licence=UNKNOWN_LICENCE,
        input=NetworkInput(own.channels, multiple=1, scaled_px=max(own.input_px)),
        head=NetworkHead.OWN,
        joints=LAYOUTS[own.layout].joints,
        own=own,
    )


def _copy(source: Path, target: Path) -> None:
    try:
        if source.stat().st_size > _MAX_BYTES:
            raise ModelError(f"{source.name} is larger than networks may be ({_MAX_BYTES >> 20} MiB).")
        shutil.copyfile(source, target)
    except OSError as error:
        raise ModelError(f"{source.name} can't be read or copied: {error.strerror}.") from error


def _endless(filename: str) -> ModelError:
    return ModelError(
        f"{filename} can't be used: it gave no output for one image within the time of the check. Use a network "
        "without endless loops, or a smaller one."
    )


def _with_size(network: OwnNetwork, shape: Sequence[int | None], has_chosen_size: bool, filename: str) -> OwnNetwork:
    """Network with the size of its input; ``shape`` is the file's, with ``None`` for open axes."""
    batch, channels, height, width = shape
    if batch not in {None, 1} or channels not in {None, 3}:
        raise ModelError(f"{filename} can't be used: its input must be (1, 3, height, width), it is {list(shape)}.")
    size = (width or network.input_px[0], height or network.input_px[1])
    if has_chosen_size and size != network.input_px:
        raise ModelError(f"{filename} has an input of {size[0]}x{size[1]} pixels: use --input-size {size[0]}x{size[1]}")
    return replace(network, input_px=size)


def _check_outputs(network: OwnNetwork, shapes: Sequence[Sequence[int]], filename: str) -> None:
    num_points = len(LAYOUTS[network.layout].points)
    width, height = network.input_px
    match network.head, [tuple(shape) for shape in shapes]:
        case "simcc", [(1, in_x, bins_x), (1, in_y, bins_y)]:
            fits, num_outputs = bins_x * height == bins_y * width and in_x == in_y and bins_x >= width, in_x
        case "heatmaps", [(1, num_outputs, rows, columns)]:
            fits = min(rows, columns) >= 2
        case "rtmo", [(1, num_boxes, 5), (1, num_people, num_outputs, 3)]:
            fits = num_boxes == num_people
        case _:
            fits, num_outputs = False, num_points
    if not fits:
        raise ModelError(
            f"{filename} has no outputs of the head {network.head}: it gives {[list(shape) for shape in shapes]}. "
            "See docs/guide/detectors.md for the outputs of each head."
        )
    if num_outputs != num_points:
        alike = [layout.name for layout in LAYOUTS.values() if len(layout.points) == num_outputs]
        hint = f" Use --joints {' or '.join(alike)}." if alike else ""
        raise ModelError(f"{filename} finds {num_outputs} points, {network.layout} has {num_points}.{hint}")
