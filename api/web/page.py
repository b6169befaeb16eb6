"""Pages at ``/``, ``/record`` (phones) and ``/docs`` (Swagger UI), files at ``/portal``, and the contracts."""

import json
import os
from functools import cache
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from api.web.dependencies import ServicesDep
from api.web.http.middleware import SAFE_HEADERS
from api.web.live.schemas import describe_live
from api.web.recordings.messages import describe_recordings
from worker.store.errors import NotFound

router = APIRouter(include_in_schema=False)

_FOLDER = Path(__file__).parents[1] / "portal"
# Files of the folder that are only there to install its libraries are not served.
_SERVED = frozenset({".css", ".html", ".js", ".map", ".png", ".svg"})
# Another version of the service has other files of the same names, so browsers revalidate them each time.
_REVALIDATED = {"Cache-Control": "no-cache"}
_POLICY = SAFE_HEADERS["Content-Security-Policy"]
# The page shows videos and pictures of captures, also pictures that it draws itself.
_PAGE_POLICY = _POLICY.replace("img-src 'self'", "img-src 'self' blob: data:").replace(
    "media-src 'self'", "media-src 'self' blob:"
)
# Swagger UI's style sheet contains its arrows as data: images.
_DOCS_POLICY = _POLICY.replace("img-src 'self'", "img-src 'self' data:")


class PortalFiles(StaticFiles):
    """Static files of the page and of Swagger UI.

    Only the release files of the package ``fastapi_swagger`` are served. Its code, which loads a script, is not used.
    """

    def __init__(self) -> None:
        super().__init__(directory=_FOLDER, packages=[("fastapi_swagger", "resources")])

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        """Find a file that browsers need."""
        name = PurePosixPath(path)
        if name.suffix not in _SERVED or "node_modules" in name.parts:
            return "", None
        return super().lookup_path(path)

    def file_response(
        self, full_path: PathLike[str] | str, stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Answer with a file, or with 304 if the browser has its current version."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers.update(_REVALIDATED)
        return response


@router.get("/")
def get_page() -> FileResponse:
    """Answer with the page."""
    return FileResponse(_FOLDER / "index.html", headers={**_REVALIDATED, "Content-Security-Policy": _PAGE_POLICY})


@router.get("/record")
def get_phone_page() -> FileResponse:
    """Answer with the page of phones that are cameras of a recording."""
    page = _FOLDER / "record" / "phone.html"
    return FileResponse(page, headers={**_REVALIDATED, "Content-Security-Policy": _PAGE_POLICY})


@router.get("/docs")
def get_docs() -> FileResponse:
    """Answer with Swagger UI, which shows the contract."""
    return FileResponse(_FOLDER / "docs.html", headers={**_REVALIDATED, "Content-Security-Policy": _DOCS_POLICY})


@router.get("/certificate")
def get_certificate(services: ServicesDep) -> FileResponse:
    """Answer with the certificate of the service's own authority, which phones install to trust the service."""
    path = services.settings.certificate_authority
    if path is None or not path.is_file():
        raise NotFound("The service has no authority of its own.")
    return FileResponse(path, media_type="application/x-x509-ca-cert", filename="multicap-authority.crt")


@router.get("/openapi.json")
def get_contract(request: Request) -> Response:
    """Answer with the contract."""
    return Response(_contract_json(request.app), media_type="application/json")


@router.get("/live.asyncapi.json")
def get_live_contract() -> dict[str, Any]:
    """Answer with the contract of the WebSocket of live captures."""
    return describe_live()


@router.get("/recordings.asyncapi.json")
def get_recordings_contract() -> dict[str, Any]:
    """Answer with the contract of the WebSocket of recordings by phones."""
    return describe_recordings()


@cache
def _contract_json(app: FastAPI) -> bytes:
    return json.dumps(app.openapi(), ensure_ascii=False, separators=(",", ":")).encode()
