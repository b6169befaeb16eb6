"""Resource of the web API: what its folder gives to the application and to the contract."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fastapi import APIRouter

from api.web.http.bodies.form_kinds import FormKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Resource:
    """A resource, or a part of it; ``api.web.resources`` registers each.

    Parameters
    ----------
    router
        Routes of the resource.
    is_open
        Whether its routes need no key.
    answers
        Examples of responses by name; see ``api.web.contract.description.answer``.
    forms
        Kinds of the forms that its routes take.
    """

    router: APIRouter
    is_open: bool = False
    answers: Mapping[str, Any] = field(default_factory=dict)
    forms: tuple[FormKind, ...] = ()
