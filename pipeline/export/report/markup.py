"""HTML from values that come from strangers: text is always escaped, and data can't end their element."""

import base64
import hashlib
import html
import json
from collections.abc import Iterable
from typing import Any

_VOID = frozenset({"img", "input", "meta"})
# Characters that end a script element or a comment, and the line ends of JavaScript before 2019.
_UNSAFE = {ord(char): f"\\u{ord(char):04x}" for char in "<>&\u2028\u2029"}


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def element(tag: str, *content: str | Iterable[str], **attributes: str | int | bool | None) -> Markup:
    """Write an element.

    ``content``: elements as they are, other text escaped. ``attributes``: values are escaped; an underscore in a name
    is a hyphen, one at its end is dropped. ``True`` writes the name alone, ``False`` and ``None`` leave the attribute
    out.

    >>> element("p", "a < b", element("b", "c"), class_='"')
    '<p class="&quot;">a &lt; b<b>c</b></p>'
    """
    words = [tag]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(name)
        elif value is not None and value is not False:
            words.append(f'{name}="{html.escape(str(value))}"')
    start = f"<{' '.join(words)}>"
    return Markup(start if tag in _VOID else f"{start}{join(*content)}</{tag}>")


def join(*content: str | Iterable[str]) -> Markup:
    """Join elements and text, which is escaped."""
    parts = (part for item in content for part in ([item] if isinstance(item, str) else item))
    return Markup("".join(part if isinstance(part, Markup) else html.escape(part) for part in parts))


def data(identifier: str, value: Any) -> Markup:
    """Element with a JSON value for the script of the page; no text in it can end the element."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":")).translate(_UNSAFE)
    return Markup(f'<script type="application/json" id="{identifier}">{text}</script>')


def source_hash(text: str) -> str:
    """Source expression of an inline script or style for a Content-Security-Policy."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
