"""Checker of types and shapes that `MULTICAP_CHECK_SHAPES` puts around all functions of the pipeline."""

import os

import pytest
from beartype import BeartypeConf, beartype

# An integer is a float wherever a float is asked for, as PEP 484 says and mypy holds.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))

of_wrong_types = pytest.mark.skipif(
    bool(os.environ.get("MULTICAP_CHECK_SHAPES")), reason="the checker refuses the arguments of this test"
)
"""Mark of tests that call functions with what their annotations exclude."""
