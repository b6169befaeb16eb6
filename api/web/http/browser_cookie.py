"""Cookie of a browser's session: its name by the connection, set and deleted."""

from starlette.requests import HTTPConnection
from starlette.responses import Response

NAME = "multicap_session"


def cookie_name(connection: HTTPConnection) -> str:
    """Name of the cookie on this connection.

    Over TLS the prefix makes browsers refuse a cookie that another host of the domain has set, or that came over an
    unencrypted connection; without TLS they refuse the prefix.
    """
    return f"__Host-{NAME}" if _is_encrypted(connection) else NAME


def _is_encrypted(connection: HTTPConnection) -> bool:
    return connection.url.scheme in {"https", "wss"}


def set_cookie(connection: HTTPConnection, response: Response, secret: str, lifetime_s: int) -> None:
    """Let a browser keep the secret of its session."""
    name, is_secure = cookie_name(connection), _is_encrypted(connection)
    response.set_cookie(name, secret, max_age=lifetime_s, httponly=True, samesite="strict", secure=is_secure)


def delete_cookie(connection: HTTPConnection, response: Response) -> None:
    """Let a browser forget its session."""
    is_secure = _is_encrypted(connection)
    response.delete_cookie(cookie_name(connection), httponly=True, samesite="strict", secure=is_secure)


def deletion(connection: HTTPConnection) -> str:
    """Value of ``Set-Cookie`` that deletes the cookie of this connection."""
    response = Response()
    delete_cookie(connection, response)
    return response.headers["set-cookie"]
