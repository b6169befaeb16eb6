"""The page at ``/``: jobs, their results, a form to send a session."""

from importlib.resources import files

from fastapi import APIRouter, Response

router = APIRouter(include_in_schema=False)

_MEDIA_TYPES = {
    "index.html": "text/html",
    "page.js": "text/javascript",
    "page.css": "text/css",
    "icon.svg": "image/svg+xml",
}
_CONTENTS = {name: (files("api.portal") / name).read_bytes() for name in _MEDIA_TYPES}


def _serve(name: str) -> Response:
    return Response(_CONTENTS[name], media_type=_MEDIA_TYPES[name], headers={"Cache-Control": "no-cache"})


@router.get("/")
def get_page() -> Response:
    """Show the page."""
    return _serve("index.html")


@router.get("/portal/page.js")
def get_script() -> Response:
    """Give the page its script."""
    return _serve("page.js")


@router.get("/portal/page.css")
def get_style() -> Response:
    """Give the page its style."""
    return _serve("page.css")


@router.get("/portal/icon.svg")
def get_icon() -> Response:
    """Give the page its icon."""
    return _serve("icon.svg")
