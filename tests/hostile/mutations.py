"""Random damage of text and bytes; a generator with the same seed causes the same damage."""

import random
import re
from collections.abc import Callable, Sequence

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

NUMBERS: Sequence[bytes] = (
    b"1e300", b"-1e300", b"1e308", b"1.7976931348623157e308", b"5e-324", b"-5e-324", b"1e-300", b"0", b"-0.0", b"1e9",
    b"1e400", b"-1e400", b"nan", b"NaN", b"inf", b"Infinity", b"-Infinity", b"9" * 400, b"1" + b"0" * 5000, b"0x10",
    b"1_000", b"0.5", b"-1", b"9223372036854775808", b"18446744073709551616", b"true", b"null", b'"1"', b'"text"',
    b"[]", b"{}", b"[[1, 2], [3]]", b"1979-05-27T07:32:00Z", b"", b"1e99999999999", b"-", b"\xff", b"\\ud800",
    "\u0661".encode(),
)  # fmt: skip

_TEXTS: Sequence[bytes] = (
    b"[" * 3000,
    b"{" * 3000,
    b'{"a":' * 3000,
    b"<a>" * 3000,
    b"&lt;&amp;",
    b"\0",
    b"\r",
    b'"',
    b"'",
    b",",
    b"=",
    b"\n[x]\n",
    b'\n"" = 1\n',
    b"\\ud800",
    "\u202e\u2028".encode(),
    b"\xed\xa0\x80",
    b'"constructor": {"__proto__": 1},',
    b"x" * 200_000,
)

_ENCODINGS = ("utf-16", "utf-32", "utf-16-be", "utf-8-sig", "cp037", "utf-7")
_DECLARED = (b"klingon", b"utf-16", b"utf-7", b"cp037", b"rot13", b"base64", b"")


def number(content: bytes, rng: random.Random) -> bytes:
    """Replace a number, or many numbers, by another number or by text that is not a number."""
    found = list(NUMBER.finditer(content))
    if not found:
        return content
    new, share = rng.choice(NUMBERS), rng.choice((0.0, 0.0, 0.0, 0.3, 1.0))
    chosen = {rng.randrange(len(found))} | {index for index in range(len(found)) if rng.random() < share}
    parts, end = [], 0
    for index in sorted(chosen):
        parts += [content[end : found[index].start()], new]
        end = found[index].end()
    return b"".join([*parts, content[end:]])


def lines(content: bytes, rng: random.Random) -> bytes:
    """Remove, repeat or swap lines, or repeat a line a thousand times."""
    parts = content.splitlines(keepends=True) or [b""]
    one, other = rng.randrange(len(parts)), rng.randrange(len(parts))
    match rng.randrange(4):
        case 0:
            del parts[one]
        case 1:
            parts[one:one] = parts[min(one, other) : max(one, other) + 1]
        case 2:
            parts[one], parts[other] = parts[other], parts[one]
        case _:
            parts[one:one] = [parts[one]] * 1000
    return b"".join(parts)


def text(content: bytes, rng: random.Random) -> bytes:
    """Insert text from another place."""
    position = rng.randrange(len(content) + 1)
    return content[:position] + rng.choice(_TEXTS) + content[position:]


def encoding(content: bytes, rng: random.Random) -> bytes:
    """Change the encoding, or only the declaration of the encoding."""
    if rng.random() < 0.5:
        return b'<?xml version="1.0" encoding="' + rng.choice(_DECLARED) + b'"?>\n' + content
    return content.decode(errors="replace").encode(rng.choice(_ENCODINGS), errors="replace")


def flip(content: bytes, rng: random.Random) -> bytes:
    """Flip some bits."""
    spoilt = bytearray(content)
    for _ in range(rng.choice((1, 1, 3, 20)) if spoilt else 0):
        spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
    return bytes(spoilt)


def cut(content: bytes, rng: random.Random) -> bytes:
    """Remove the end, or a piece of the middle."""
    start = rng.randrange(len(content) + 1)
    return content[:start] if rng.random() < 0.5 else content[:start] + content[start + rng.randrange(1, 500) :]


def insert(content: bytes, rng: random.Random) -> bytes:
    """Insert noise, or a piece of the content itself."""
    position, start = rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)
    length = rng.choice((1, 4, 50, 500))
    new = rng.randbytes(length) if rng.random() < 0.5 else content[start : start + length]
    return content[:position] + new + content[position:]


OF_BYTES: Sequence[Callable[[bytes, random.Random], bytes]] = (flip, cut, insert)
OF_TEXT: Sequence[Callable[[bytes, random.Random], bytes]] = (number, number, number, number, lines, text, encoding)


def spoil(content: bytes, rng: random.Random, ways: Sequence[Callable[[bytes, random.Random], bytes]]) -> bytes:
    """Damage content in one way or in several ways."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(ways)(content, rng)
    return content
