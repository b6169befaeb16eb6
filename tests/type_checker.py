"""Checker of types and shapes that `MULTICAP_CHECK_SHAPES` puts around all functions of the pipeline."""

from beartype import BeartypeConf, beartype

# An integer is a float wherever a float is asked for, as PEP 484 says and mypy holds.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
