"""`multicap sync`: clocks of cameras, measured from people."""

from api.cli.commands.sync.measure import command

__all__ = ["command"]
