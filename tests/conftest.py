"""Shapes and types of every public call are checked while the tests run."""

import signal

from hypothesis import settings
from jaxtyping import install_import_hook

# The machines are shared: how long an example takes says nothing.
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")

# A shell starts background programs with SIGINT ignored, and their children inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)

install_import_hook("pipeline", "beartype.beartype")
