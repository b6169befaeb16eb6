"""Error of a video that can't be used."""

from pathlib import Path

from pipeline.errors import Problem


class UnusableError(Exception):
    """The file can't be used: problem code, message and hint."""

    def __init__(self, code: str, message: str, hint: str | None = None) -> None:
        super().__init__(code)
        self.code, self.message, self.hint = code, message, hint

    def problem(self, path: Path) -> Problem:
        """Build the problem, with the name of the file."""
        return Problem(self.code, self.message, file=path.name, hint=self.hint)
