"""Transactions as repositories see them: each call begins its own, or all calls join one that is open."""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from sqlalchemy import Connection


class Transactions(Protocol):
    """Source of transactions: ``Database`` begins one for each block, ``OpenTransaction`` lends the one it has."""

    def reading(self) -> AbstractContextManager[Connection]:
        """Transaction that reads."""

    def writing(self) -> AbstractContextManager[Connection]:
        """Transaction that writes."""


@dataclass(frozen=True, slots=True)
class OpenTransaction:
    """A transaction that writes and is open already; the block that began it commits it or rolls it back."""

    connection: Connection

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """Lend the connection."""
        yield self.connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[Connection]:
        """Lend the connection."""
        yield self.connection
