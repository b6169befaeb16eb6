"""Choices of the making of proxies. Standard library only: web API, job store and stages read them."""

from dataclasses import dataclass

PROXY_KIND = "proxy"
"""Kind of the result files that are proxies."""


@dataclass(frozen=True, slots=True)
class ProxyChoices:
    """Cameras whose videos get a proxy: a small copy that browsers play."""

    cameras: tuple[str, ...]


def proxy_name(number: int) -> str:
    """Name of the result file with the proxy of the camera that has a number in its session, from 0."""
    return f"proxy-{number}.mp4"
