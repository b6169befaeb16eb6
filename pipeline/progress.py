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


OnShare = Callable[[float], None]
"""Takes the share of a piece of work that is done, from 0 to 1, ascending."""


def ignore(_: float) -> None:
    """Report nothing."""


def part_of(on_share: OnShare, start: float, stop: float) -> OnShare:
    """Report the shares of a part of the work, which goes from one share of the whole to another."""
    return lambda share: on_share(start + (stop - start) * share)


def in_units(total: int, on_unit: Callable[[], None]) -> OnShare:
    """Report shares as so many units: one call for each unit that is done."""
    done = 0

    def on_share(share: float) -> None:
        nonlocal done
        while done < int(share * total):
            done += 1
            on_unit()

    return on_share
