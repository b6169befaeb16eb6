"""Errors of requests to a service: it refuses, it is away, or something else has its address."""

import http.client
import re
import socket
import ssl
import urllib.error

from api.blender.extension.answers import AnswerError, RequestError, parsed, sentences

_MAX_PROBLEM_BYTES = 1 << 18


class RefusedError(RequestError):
    """The service refused a request."""

    def __init__(self, status: int, text: str, location: str = "", retry_after_s: float = 0.0) -> None:
        super().__init__(text)
        self.status, self.location, self.retry_after_s = status, location, retry_after_s


class AwayError(RequestError):
    """The service does not answer; a later try may succeed."""


def refusal(error: urllib.error.HTTPError, host: str, *, has_key: bool) -> RefusedError:
    """Error with the service's sentences; a proxy answers without any."""
    try:
        content = error.read(_MAX_PROBLEM_BYTES)
        text = sentences(parsed(content))
    except (OSError, http.client.HTTPException, AnswerError):
        text = ""
    if error.code == http.client.UNAUTHORIZED:
        text = (
            "The service does not know this key, or the key has expired or was revoked. Check the key."
            if has_key
            else "The service asks for a key. Put it into the extension's preferences."
        )
    after = error.headers.get("Retry-After", "")
    return RefusedError(
        error.code,
        text or f"The server at {host} answered {error.code}.",
        error.headers.get("Location", "")
        if http.client.MULTIPLE_CHOICES <= error.code < http.client.BAD_REQUEST
        else "",
        float(after) if re.fullmatch(r"\d{1,6}", after, re.ASCII) else 0.0,
    )


def no_answer(reason: object, host: str) -> RequestError:
    """Error of a connection that could not be made, or broke."""
    is_wrong = True
    match reason:
        case ssl.SSLCertVerificationError():
            text = f"The certificate of {host} can't be verified, so nothing was sent. Check the address."
        case ssl.SSLError():
            text = f"The server at {host} does not speak https. Check the address: http or https?"
        case http.client.BadStatusLine() | http.client.LineTooLong() if not isinstance(reason, ConnectionError):
            text = f"The server at {host} is not a Multicap service. Check the address: http or https?"
        case _:
            is_wrong = False
            texts = {
                socket.gaierror: f"There is no server {host}, or no network. Check the address.",
                ConnectionRefusedError: f"Nothing answers at {host}. Is the service running? Check address and port.",
                TimeoutError: f"The server at {host} did not answer in time.",
            }
            broken = f"The connection to {host} broke off."
            text = next((words for kind, words in texts.items() if isinstance(reason, kind)), broken)
    return RequestError(text) if is_wrong else AwayError(text)
