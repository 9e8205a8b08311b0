"""Servers on this computer alone."""

from __future__ import annotations

import socket

from neuroflight.toolchain.errors import LinkError


def listen(what: str, port: int) -> socket.socket:
    """Return a listening socket at 127.0.0.1 that never waits; `port` 0: any free one.

    Raises LinkError, which says `what` the port is for, if it is taken.
    """
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise LinkError(
            f"{what} port {port}: {error.strerror}, expected a free port; name another one, or 0 for any"
        ) from None
    listener.setblocking(False)
    return listener
