"""How far a reconstruction is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Stage = Literal["detect", "lengths", "poses", "associate", "fit"]


@dataclass(frozen=True, slots=True)
class Progress:
    """``done`` of ``total`` steps of a stage: frames of all cameras, output frames, or the whole."""

    stage: Stage
    done: int
    total: int


OnProgress = Callable[[Progress], None]


def silent(_: Progress) -> None:
    """Report nothing."""
