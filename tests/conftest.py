"""Shapes and types of every public call are checked while the tests run."""

from hypothesis import settings
from jaxtyping import install_import_hook

# The machines are shared: how long an example takes says nothing.
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")

install_import_hook("pipeline", "beartype.beartype")
