"""The commands of `multicap`, one module each."""
