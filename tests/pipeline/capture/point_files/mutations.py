"""Damaged content of files."""

import numpy as np


def mutated(whole: bytes, random: np.random.Generator, marks: bytes = bytes(range(256))) -> bytes:
    """Content that ends early, or has 20 other bytes, or both."""
    content = bytearray(whole[: random.integers(1, len(whole) + 1)] if random.random() < 0.5 else whole)
    for place in random.integers(0, len(content), 20):
        content[place] = random.choice(list(marks))
    return bytes(content)
