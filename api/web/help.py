"""Site of the documentation at ``/help``, as `make docs` built it; ``/help/TOPIC`` leads to the page of a topic."""

import base64
import functools
import hashlib
import json
import os
import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

from starlette.responses import RedirectResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from api.web.errors import ApiError
from api.web.http.middleware import SAFE_HEADERS
from pipeline.core.problems.request_codes import NOT_FOUND

FOLDER = Path(__file__).parents[1] / "portal" / "help"
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


class HelpFiles(StaticFiles):
    """Static files of the site."""

    def __init__(self, folder: Path = FOLDER) -> None:
        super().__init__(directory=folder, html=True, check_dir=False)
        self._folder = folder

    async def check_config(self) -> None:
        """Accept that the folder is missing: the site may not be built, which the answers say."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a file of the site, or with the way to the page of a topic."""
        if not (self._folder / "topics.json").is_file():
            raise ApiError(NOT_FOUND, "The documentation is not built here.", hint="Run `make docs` in the checkout.")
        topic = read_topics(self._folder).get(path)
        if topic is not None:
            return RedirectResponse(f"{scope['root_path']}/{topic['page']}")
        return await super().get_response(path, scope)

    def file_response(
        self, full_path: PathLike[str] | str, stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Answer with a file; a page may run its own scripts, and styles that stand in it."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Cache-Control"] = "no-cache"
        if Path(full_path).suffix == ".html":
            response.headers["Content-Security-Policy"] = _policy(str(full_path), stat_result.st_mtime)
        return response


@functools.lru_cache(maxsize=256)
def _policy(page: str, _modified_s: float) -> str:
    """Security policy of a page: by the digests of its scripts."""
    scripts = _SCRIPT.findall(Path(page).read_text(encoding="utf-8"))
    digests = {base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts}
    allowed = " ".join(("'self'", *(f"'sha256-{digest}'" for digest in sorted(digests))))
    return (
        SAFE_HEADERS["Content-Security-Policy"]
        .replace("script-src 'self'", f"script-src {allowed}; worker-src 'self'")
        .replace("style-src 'self'", "style-src 'self' 'unsafe-inline'")
        .replace("img-src 'self'", "img-src 'self' data:")
    )


@functools.cache
def read_topics(folder: Path = FOLDER) -> Mapping[str, Mapping[str, str]]:
    """Read the topics by their names: title, page, and what the page is for."""
    topics: Mapping[str, Mapping[str, str]] = json.loads((folder / "topics.json").read_text(encoding="utf-8"))
    return topics
