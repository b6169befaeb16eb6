"""The page at ``/``: jobs, their results, a form to send a session. At ``/docs``: the contract, by Swagger UI."""

from importlib.resources import files

from fastapi import APIRouter, Response

from api.middleware import SAFE_HEADERS

router = APIRouter(include_in_schema=False)

_MEDIA_TYPES = {
    "index.html": "text/html",
    "page.js": "text/javascript",
    "page.css": "text/css",
    "icon.svg": "image/svg+xml",
    "docs.html": "text/html",
    "docs.js": "text/javascript",
}
# The package holds the files of Swagger UI's releases; its code, which has browsers load a script, is not used.
_SWAGGER_UI = {"swagger-ui-bundle.js": "text/javascript", "swagger-ui.css": "text/css"}
_CONTENTS = {
    **{name: (files("api.portal") / name).read_bytes() for name in _MEDIA_TYPES},
    **{name: (files("fastapi_swagger") / "resources" / name).read_bytes() for name in _SWAGGER_UI},
}
# Swagger UI's style draws its arrows from pictures that are part of it.
_DOCS_POLICY = SAFE_HEADERS["Content-Security-Policy"].replace("img-src 'self'", "img-src 'self' data:")


def _serve(name: str) -> Response:
    media_type = (_MEDIA_TYPES | _SWAGGER_UI)[name]
    return Response(_CONTENTS[name], media_type=media_type, headers={"Cache-Control": "no-cache"})


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


@router.get("/docs")
def get_docs() -> Response:
    """Show the contract."""
    answer = _serve("docs.html")
    answer.headers["Content-Security-Policy"] = _DOCS_POLICY
    return answer


@router.get("/portal/docs.js")
def get_docs_script() -> Response:
    """Give the contract's page its script."""
    return _serve("docs.js")


@router.get("/portal/swagger-ui-bundle.js")
def get_swagger_ui() -> Response:
    """Give the contract's page Swagger UI."""
    return _serve("swagger-ui-bundle.js")


@router.get("/portal/swagger-ui.css")
def get_swagger_ui_style() -> Response:
    """Give the contract's page the style of Swagger UI."""
    return _serve("swagger-ui.css")
