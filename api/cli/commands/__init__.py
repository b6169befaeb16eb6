"""Commands of `multicap`, a module for each command."""
