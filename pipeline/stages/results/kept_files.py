"""Files of people as pieces of the output of ``export``: written once, whatever is edited elsewhere.

A piece is a line of JSON with the sizes of the files and the distances found in them, and then the files.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from pipeline.export.person_files import Distances, KeptFiles, PersonOfTake, replacing, spoilt
from pipeline.stages.results.pieces import Pieces


class FilesInPieces(KeptFiles):
    """Files of people that earlier tasks have kept, and those that this task keeps.

    Parameters
    ----------
    pieces
        Pieces of the task.
    scratch
        Folder for temporary files of the task.
    """

    def __init__(self, pieces: Pieces, scratch: Path) -> None:
        self.pieces, self._scratch = pieces, scratch

    def find(self, person: PersonOfTake, paths: Mapping[str, Path]) -> Distances | None:
        """Write a person's files, if they are kept, and read them back."""
        piece = self.pieces.find(self.pieces.key(person))
        if piece is None:
            return None
        head, _, content = piece.partition(b"\n")
        described = json.loads(head)
        start = 0
        for name, path in paths.items():
            of_file = content[start : start + described["sizes"][name]]
            with replacing(path, [of_file]) as part:
                if part.read_bytes() != of_file:
                    raise spoilt(path)
            start += len(of_file)
        distances_mm: dict[str, float | None] = described["distances_mm"]
        return distances_mm

    def keep(self, person: PersonOfTake, paths: Mapping[str, Path], distances_mm: Distances) -> None:
        """Keep copies of a person's files."""
        piece = self._scratch / f"piece-{person.track.track_id}"
        head = {"sizes": {name: path.stat().st_size for name, path in paths.items()}, "distances_mm": distances_mm}
        with piece.open("wb") as file:
            file.write(json.dumps(head).encode() + b"\n")
            for path in paths.values():
                file.write(path.read_bytes())
        self.pieces.keep(self.pieces.key(person), piece)
