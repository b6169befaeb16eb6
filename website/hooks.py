"""Hooks of MkDocs: diagrams are rendered at build time, decisions are listed, and topics are indexed.

Beside each page the site has its Markdown, which ``multicap help TOPIC`` prints; ``topics.json`` lists all topics.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[1]
_NODE = shutil.which("node", path=Path(sys.executable).parent) or shutil.which("node") or "node"
_DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LISTS = {"reference/http-operations.md", "reference/python-names.md"}
# Files of the repository that the service answers at other addresses
_SERVED = {"../../openapi/openapi.json": "/openapi.json"}


def on_config(config: Any) -> Any:
    """Put the notebook into the navigation: an entry that is a folder becomes the pages in it."""
    config.nav = [_expanded(entry, Path(config.docs_dir)) for entry in config.nav]
    return config


def _expanded(entry: Any, docs: Path) -> Any:
    if isinstance(entry, dict):
        return {title: _expanded(value, docs) for title, value in entry.items()}
    if isinstance(entry, list):
        return [page for value in entry for page in _pages(value, docs)]
    return _pages(entry, docs) if entry.endswith("/") else entry


def _pages(entry: Any, docs: Path) -> list[Any]:
    """Pages of an entry in a list: all files if it is a folder, and its index first."""
    if isinstance(entry, str) and entry.endswith("/"):
        names = sorted(path.name for path in (docs / entry).glob("*.md"))
        return [entry + name for name in sorted(names, key=lambda name: name != "index.md")]
    return [_expanded(entry, docs)]


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace each Mermaid diagram of a page by its picture; searches find the notebook and long lists last."""
    if page.file.src_uri.startswith("lab/") or page.file.src_uri in _LISTS:
        page.meta["search"] = {"boost": 0.2}
    for inside, served in _SERVED.items():
        markdown = markdown.replace(f"({inside})", f"({served})")
    sources = _DIAGRAM.findall(markdown)
    if not sources:
        return markdown
    done = subprocess.run(  # noqa: S603 - our own script
        [_NODE, _ROOT / "website/diagrams.mjs"], input=json.dumps(sources), capture_output=True, text=True, check=True
    )
    pictures = iter(json.loads(done.stdout))
    # A blank line would end the block of HTML.
    return _DIAGRAM.sub(lambda _: re.sub(r"\n\s*\n", "\n", f"<div>{next(pictures)}</div>"), markdown)


def on_post_build(config: Any) -> None:
    """Write the Markdown of all pages and the index of topics."""
    site, docs = Path(config.site_dir), Path(config.docs_dir)
    shutil.copy(_ROOT / "api/portal/icon.svg", site / "images")
    topics: dict[str, dict[str, str]] = {}
    for page in sorted(docs.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        title, _, rest = text.partition("\n")
        path = page.relative_to(docs)
        topic = "-".join(path.with_suffix("").parts[1:]) or page.stem
        if topic in topics and topic != "index":
            raise ValueError(f"Two pages are the topic {topic}: rename {path}.")
        topics[topic] = {
            "about": " ".join(rest.strip().partition("\n\n")[0].split()),
            "page": path.with_suffix(".html").as_posix(),
            "title": title.removeprefix("# "),
        }
        (site / path).write_text(text, encoding="utf-8")
    # Maps of the theme's sources, and searches in other languages: a quarter of the site.
    for path in (*site.glob("assets/**/*.map"), *site.glob("assets/javascripts/lunr/**/*.js")):
        path.unlink()
    (site / "topics.json").write_text(json.dumps(topics, indent=1), encoding="utf-8")
