"""How far a reconstruction is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
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
    return lambda share: on_share(start * (1.0 - share) + stop * share)


def split(on_share: OnShare, weights: Sequence[int]) -> list[OnShare]:
    """Split work into parts that follow each other, and return how each part reports its own share.

    Parameters
    ----------
    weights
        Amount of work in each part.
    """
    total = sum(weights) or 1
    borders = [border / total for border in accumulate(weights, initial=0)]
    return [part_of(on_share, *ends) for ends in pairwise(borders)]


def in_units(total: int, on_unit: Callable[[], None]) -> OnShare:
    """Report shares as so many units: one call for each unit that is done."""
    done = 0

    def on_share(share: float) -> None:
        nonlocal done
        while done < int(share * total):
            done += 1
            on_unit()

    return on_share
