"""`multicap help`: show a page of the documentation in the terminal."""

import difflib
from typing import Annotated

import typer
from rich.console import Console
from rich.markdown import Markdown

from api.cli.console import print_table, refusal, shows_help

if not shows_help():
    from api.web.help import FOLDER, read_topics


def command(
    topic: Annotated[
        str | None, typer.Argument(help="Name of a page, such as calibration. Default: all names.")
    ] = None,
) -> None:
    """Show a page of the documentation. A running service has the same pages at /help."""
    if not (FOLDER / "topics.json").is_file():
        raise refusal("The documentation is not built here. Run `make docs` in the checkout.")
    topics = read_topics()
    if topic is None:
        print_table(("topic", "title"), ((name, found["title"]) for name, found in topics.items()))
        return
    if topic not in topics:
        near = difflib.get_close_matches(topic, topics)
        hint = f"Similar: {', '.join(near)}." if near else "`multicap help` lists all topics."
        raise refusal(f"There is no topic {topic}. {hint}")
    page = (FOLDER / topics[topic]["page"]).with_suffix(".md")
    console = Console()
    if console.is_terminal:
        with console.pager(styles=True):
            console.print(Markdown(page.read_text(encoding="utf-8")))
    else:
        typer.echo(page.read_text(encoding="utf-8"), nl=False)
