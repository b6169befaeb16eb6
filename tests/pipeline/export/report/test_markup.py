"""Markup: nothing that a stranger names becomes an element, an attribute or the end of a script."""

import json
from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from pipeline.export.report.markup import data, element, join, source_hash


class Reader(HTMLParser):
    """Elements with their attributes, and all text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


HOSTILE = st.text(alphabet=st.sampled_from("<>&\"'/=-!ab\u2028") | st.characters(exclude_categories=["Cs", "Cc"]))


@given(HOSTILE, HOSTILE)
def test_text_and_values_stay_what_they_are(text: str, value: str) -> None:
    read = Reader(element("p", text, title=value))
    assert read.elements == [("p", {"title": value})]
    assert read.text == text


@given(HOSTILE)
def test_data_come_back_and_end_no_element(text: str) -> None:
    markup = data("take", {"name": text})
    assert markup.count("<") == 2
    content = markup.partition(">")[2].rpartition("</script>")[0]
    assert json.loads(content) == {"name": text}


def test_elements_are_joined_as_they_are_and_text_is_not() -> None:
    inner = element("b", "x")
    assert join(inner, "<", [inner, ">"]) == "<b>x</b>&lt;<b>x</b>&gt;"
    assert element("input", type="range", disabled=True, hidden=False, aria_label="a") == (
        '<input type="range" disabled aria-label="a">'
    )


def test_hash_equals_example_of_specification() -> None:
    # The example of Content Security Policy Level 3, section 8.3 ("alert('Hello, world.');").
    assert source_hash("alert('Hello, world.');") == "'sha256-qznLcsROx4GACP2dm0UCKCzCG+HiZ1guq6ZZDob/Tng='"
