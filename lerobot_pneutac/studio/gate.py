"""The door of the studio: the only address that a browser reaches, and who may come in.

The viewer behind it listens on this machine alone. A page of another site, opened in the same browser, is
refused by its `Origin`, and a foreign name for this machine by its `Host`; from other machines a token is
asked for once and then kept as a cookie.
"""

import asyncio
import hmac
import os
import re
import socket
import threading
from urllib.parse import parse_qs, urlsplit

from pneutac_sim.errors import InputError

LOCAL = ("localhost", "127.0.0.1", "::1")
COOKIE = "pneutac_studio"
ALIVE = "/alive"  # answered by the gate as long as there is one
HEAD_BYTES = 65536


class Gate:
    """Lets browsers through to a local port.

    Args:
        host: to listen on.
        port: to listen on; 0 for any that is free.
        inner_port: where the viewer listens, on this machine.
        token: that a browser has to show; empty where none is asked for, which only this machine may do.
        page: HTML that is given at `/` in place of the viewer's; empty for the viewer's own.

    Attributes:
        port: that it listens on.
        connections: how many are open.

    Raises:
        InputError: the address is in use, or none of this machine's.
    """

    def __init__(self, host: str, port: int, inner_port: int, token: str = "", page: bytes = b""):
        self._inner, self._token, self._page, self.connections = inner_port, token, page, 0
        self._names = (*LOCAL, host)
        self._socket = _bound(host, port)
        self.port = self._socket.getsockname()[1]
        self._loop, self._closed = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(
            target=self._loop.run_until_complete, args=(self._serve(),), daemon=True, name="studio gate"
        )
        self._thread.start()

    def close(self) -> None:
        """Refuses everybody from now on; the port is free again."""
        self._loop.call_soon_threadsafe(self._closed.set)
        self._thread.join(timeout=2.0)
        self._socket.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._pass, sock=self._socket, limit=HEAD_BYTES)
        await self._closed.wait()
        server.close()
        open_ones = asyncio.all_tasks() - {asyncio.current_task()}
        for task in open_ones:
            task.cancel()
        await asyncio.gather(*open_ones, return_exceptions=True)

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10.0)
            answer = self.answer(head.decode("latin-1")).encode() or self._own(head)
            if answer:
                writer.write(answer)
                await writer.drain()
                return
            inner = await asyncio.open_connection("127.0.0.1", self._inner)
            # one request a connection, so that each is looked at: a page asks for few files
            inner[1].write(head if b"\r\nupgrade:" in head.lower() else _closing(head))
            self.connections += 1
            try:
                await asyncio.gather(_pump(reader, inner[1]), _pump(inner[0], writer))
            finally:
                self.connections -= 1
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # a browser that went away
        except asyncio.CancelledError:
            pass  # the gate closes
        finally:
            writer.close()

    def answer(self, head: str) -> str:
        """What a request is told instead of being let through; empty where it may pass.

        Args:
            head: of an HTTP request, up to its empty line.
        """
        first, *lines = head.split("\r\n")
        parts = first.split(" ")
        if len(parts) != 3:
            return _reply("400 Bad Request", "This is no request of a browser.")
        fields = {k.strip().lower(): v.strip() for k, _, v in (line.partition(":") for line in lines)}
        host, origin = fields.get("host", ""), fields.get("origin", "")
        if not self._token and _name(host) not in self._names:
            return _reply("403 Forbidden", "Open the studio by the address that it printed.")
        if origin and urlsplit(origin).netloc != host:
            return _reply("403 Forbidden", "Another site's page may not speak to the studio.")
        if not self._token:
            return ""
        given = parse_qs(urlsplit(parts[1]).query).get("token", [""])[0]
        if hmac.compare_digest(given.encode(), self._token.encode()):
            cookie = f"Set-Cookie: {COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
            return _reply("303 See Other", "", "Location: /", cookie)
        kept = re.search(rf"(?:^|;\s*){COOKIE}=([^;]*)", fields.get("cookie", ""))
        if kept and hmac.compare_digest(kept[1].encode(), self._token.encode()):
            return ""
        return _reply(
            "403 Forbidden", "Open the studio by the whole address that it printed, token included."
        )

    def _own(self, head: bytes) -> bytes:
        """What the gate answers itself to a browser that may pass; empty for what the viewer answers."""
        method, path = head.split(b" ", 2)[:2]
        path = path.partition(b"?")[0]
        if method != b"GET" or b"\r\nupgrade:" in head.lower():
            return b""
        if path == ALIVE.encode():
            return _reply("204 No Content", "").encode()
        if path == b"/" and self._page:
            kind = "Content-Type: text/html; charset=utf-8"
            return _head("200 OK", len(self._page), kind, "Cache-Control: no-store").encode() + self._page
        return b""


def _bound(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    except socket.gaierror as e:
        raise InputError(
            f"host={host} is no address of this machine; omit it, or give --host=0.0.0.0 to let others in."
        ) from e
    try:
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as e:
        why = os.strerror(e.errno) if getattr(e, "errno", None) else e
        raise InputError(
            f"port={port} of {host} cannot be had ({why}); another studio may be open there: close it, or"
            " give another with --port=, or --port=0 for any that is free."
        ) from e


def _name(host: str) -> str:
    """The name in a `Host` field, without its port."""
    return host.rpartition("]")[0].lstrip("[") if host.startswith("[") else host.partition(":")[0]


def _closing(head: bytes) -> bytes:
    lines = [line for line in head.split(b"\r\n") if not line.lower().startswith(b"connection:")]
    return b"\r\n".join([lines[0], b"Connection: close", *lines[1:]])


def _reply(status: str, text: str, *fields: str) -> str:
    return _head(status, len(text), "Content-Type: text/plain; charset=utf-8", *fields) + text


def _head(status: str, length: int, *fields: str) -> str:
    given = (f"Content-Length: {length}", "Connection: close")
    return "\r\n".join((f"HTTP/1.1 {status}", *given, *fields, "", ""))


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Passes on what comes until it ends."""
    try:
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    except OSError:
        pass
    finally:
        writer.close()
