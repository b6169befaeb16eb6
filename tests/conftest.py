"""Shapes and types of every public call are checked while the tests run."""

from jaxtyping import install_import_hook

install_import_hook("pipeline", "beartype.beartype")
