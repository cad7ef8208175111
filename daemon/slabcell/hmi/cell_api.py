"""How does the HMI ask the daemon?  By the control API's client, in threads; its events come in the event loop."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

from slabcell.errors import UnavailableError
from slabcell.service.api.client import Answer, ApiClient, ApiEvent

__all__ = ["CellApi", "Json"]

REQUESTS_AT_ONCE: Final = 8
TIMEOUT_S: Final = 10.0
SILENCE_S: Final = 25.0
"""The daemon gives a sign at least every ten seconds."""
MAX_LINE_BYTES: Final = 4 << 20

Json = dict[str, Any]


class CellApi:
    """Asks one daemon at its socket.  Every method raises SlabcellError, UnavailableError if nobody answers."""

    def __init__(self, socket: Path, *, timeout_s: float = TIMEOUT_S) -> None:
        self.socket = socket
        self._timeout_s = timeout_s
        self._threads = ThreadPoolExecutor(REQUESTS_AT_ONCE, thread_name_prefix="slabcell-hmi-api")

    async def get(self, path: str, *, timeout_s: float | None = None, **query: str | float | bool) -> Json:
        """Return the JSON object of a resource; ``timeout_s`` where the daemon's bench has to work for it."""
        return await self._run(partial(self._client("", timeout_s).get, path, **query))

    async def fetch(self, path: str, **query: str | float | bool) -> Answer:
        """Return a resource of any kind."""
        return await self._run(partial(self._client("").fetch, path, **query))

    async def post(self, path: str, body: Json | None = None, *, user: str, key: str, timeout_s: float = 60.0) -> Json:
        """Have something done, once, for somebody."""
        return await self._run(partial(self._client(user, timeout_s).post, path, body, key=key))

    async def send(
        self, path: str, content: bytes, media_type: str, *, user: str, key: str, timeout_s: float = 60.0
    ) -> Json:
        """Have something done with content of another type, for somebody."""
        return await self._run(partial(self._client(user, timeout_s).send, path, content, media_type, key=key))

    def _client(self, user: str, timeout_s: float | None = None) -> ApiClient:
        return ApiClient(self.socket, timeout_s=timeout_s or self._timeout_s, on_behalf_of=user)

    async def _run(self, work: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)

    async def events(self) -> AsyncGenerator[ApiEvent | None]:
        """Yield events as they happen, and None for a mere sign of life, until the connection breaks.

        Asked in HTTP/1.0, so that the stream comes as plain lines and ends with the connection.
        """
        try:
            async with asyncio.timeout(self._timeout_s):
                reader, writer = await asyncio.open_unix_connection(str(self.socket), limit=MAX_LINE_BYTES)
        except (OSError, TimeoutError) as error:
            raise self._broken(error) from error
        try:
            writer.write(b"GET /v1/events HTTP/1.0\r\nHost: localhost\r\n\r\n")
            status = await self._line(reader)
            if b" 200 " not in status:
                msg = f"the daemon at {self.socket} gives no events: {status.decode('latin-1').strip()}"
                raise UnavailableError(msg)
            while (await self._line(reader)).strip():
                pass
            fields: dict[str, str] = {}
            while True:
                text = (await self._line(reader)).decode("utf-8").rstrip("\r\n")
                if text.startswith(":"):
                    yield None
                elif text:
                    name, _, value = text.partition(":")
                    fields[name] = value.removeprefix(" ")
                elif "data" in fields:
                    yield ApiEvent(fields.get("id", ""), fields.get("event", "message"), json.loads(fields["data"]))
                    fields = {}
        except (OSError, TimeoutError, ValueError) as error:
            raise self._broken(error) from error
        finally:
            writer.close()

    async def _line(self, reader: asyncio.StreamReader) -> bytes:
        async with asyncio.timeout(SILENCE_S):
            line = await reader.readline()
        if not line:
            msg = "the connection ended"
            raise ConnectionResetError(msg)
        return line

    def _broken(self, error: Exception) -> UnavailableError:
        return UnavailableError(f"no daemon answers at {self.socket}: {error or type(error).__name__}")

    async def close(self) -> None:
        """End the threads."""
        await asyncio.to_thread(self._threads.shutdown, wait=True, cancel_futures=True)
