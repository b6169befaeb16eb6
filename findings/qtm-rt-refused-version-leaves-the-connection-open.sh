#!/usr/bin/env bash
# qtm-rt: connect() returns None after a refused version, and leaves the connection to the server open.
#
# Guess: None means that there is no connection, so that a program may try the next version, or the next server.
# Seen: the error is logged, the transport is never closed, and the caller has no object to close it by. The server
# keeps each connection, and Python warns of an unclosed transport when the loop ends.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check qtm-rt==3.1.0
"$folder/venv/bin/python" - <<'PYTHON'
import asyncio
import struct
from importlib.metadata import version

import qtm_rt

HEADER = struct.Struct("<II")
ERROR, COMMAND = 0, 1


def packet(kind: int, text: bytes) -> bytes:
    return HEADER.pack(HEADER.size + len(text) + 1, kind) + text + b"\0"


async def main() -> None:
    is_open = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(packet(COMMAND, b"QTM RT Interface connected"))
        size, _ = HEADER.unpack(await reader.readexactly(HEADER.size))
        await reader.readexactly(size - HEADER.size)
        writer.write(packet(ERROR, b"Version is not supported"))
        try:
            await asyncio.wait_for(reader.read(1), 2)
            is_open.append(False)
        except asyncio.TimeoutError:
            is_open.append(True)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    connection = await qtm_rt.connect("127.0.0.1", port, version="1.99")
    await asyncio.sleep(3)
    server.close()
    print("qtm-rt", version("qtm-rt"), "connect() returned", connection, "and two seconds later the server has")
    print("  the connection still open:", is_open == [True])
    assert connection is None, "connect() has changed its behaviour"
    assert is_open == [True], "the connection is closed now"


asyncio.run(main())
PYTHON
