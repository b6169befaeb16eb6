"""Operations that create a record from sent files, each with three routes, and the way of their requests."""

from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from fastapi import APIRouter, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from api.web.contract.description import request_body
from api.web.dependencies import Services, ServicesDep
from api.web.http.bodies.form_kinds import EITHER_TYPE, FORM_TYPE, JSON_TYPE, FormKind
from api.web.http.idempotency import Answer, IdempotentRequest, IdempotentRequestDep
from api.web.sessions.receiving import Sent, received
from worker.store.tenant_records import TenantRecords

_Checked = TypeVar("_Checked")
# Ends of paths and of ids of operations, by the bodies that they take.
_WAYS = (
    ("", "", EITHER_TYPE),
    ("/from-files", "FromFiles", (FORM_TYPE,)),
    ("/from-uploads", "FromUploads", (JSON_TYPE,)),
)


@dataclass(frozen=True, slots=True)
class Creation(Generic[_Checked]):
    """How records are created."""

    form: FormKind  # Kind of the form, or of the JSON in its place
    # Checks what was sent; raises ``ApiError`` with all that is wrong
    check: Callable[[Request, Services, TenantRecords, Sent], Awaitable[_Checked]]
    add: Callable[[Services, IdempotentRequest, _Checked], Answer]  # Stores the files and the record, both or neither

    async def respond(
        self, request: Request, services: Services, idempotent: IdempotentRequest, types: Collection[str]
    ) -> Response:
        """Receive a body of one of the content types, check it and add the record; once for each idempotency key."""
        async with received(request, services, idempotent, self.form, types) as sent:
            if (earlier := await run_in_threadpool(idempotent.begin, sent.parts)) is not None:
                return earlier
            async with idempotent.held():
                checked = await self.check(request, services, idempotent.records, sent)
                answer = await run_in_threadpool(self.add, services, idempotent, checked)
        return answer.response()


@dataclass(frozen=True, slots=True)
class Texts:
    """Documentation of a route, with the webhooks that it causes."""

    summary: str
    description: str
    callbacks: list[BaseRoute] | None = None


def add_creation(
    router: APIRouter,
    path: str,
    operation_id: str,
    creation: Creation[Any],
    texts: tuple[Texts, Texts, Texts],
    **declared: Any,
) -> None:
    """Add an operation that takes a form with files or JSON that names uploads, and routes for one of these alone.

    Generators of clients need one kind of body for each operation.

    Parameters
    ----------
    texts
        Documentation of the routes for both, for the form, and for JSON.
    declared
        What all three declare, as arguments of FastAPI's ``add_api_route``.
    """

    def endpoint(types: Collection[str]) -> Callable[..., Awaitable[Response]]:
        async def create(request: Request, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
            return await creation.respond(request, services, idempotent, types)

        return create

    for (path_end, id_end, types), text in zip(_WAYS, texts, strict=True):
        router.add_api_route(
            path + path_end,
            endpoint(types),
            methods=["POST"],
            operation_id=operation_id + id_end,
            summary=text.summary,
            description=text.description,
            callbacks=text.callbacks,
            openapi_extra=request_body(creation.form, types),
            **declared,
        )
