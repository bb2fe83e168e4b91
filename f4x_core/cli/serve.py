"""`f4x serve`."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
from typing import Any

from ..errors import F4xError
from ..printing import OUTPUT, discard, print_error
from ..progress import Progress


def run_serve(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Serve the scenes of a folder to agents until the client disconnects or Ctrl-C is pressed."""
    try:
        from ..agent.server import read_token, serve_http, serve_stdio
    except ImportError as error:
        raise F4xError(
            f"f4x serve needs the package mcp from 2.3 on ({error}); install it with `pip install 'mcp>=2.3,<3'`."
        ) from error
    from ..agent.folder import SceneFolder
    from ..agent.session import Session

    logging.basicConfig(level=logging.WARNING, format="%(message)s")  # before the package does it with boxes
    session = Session(SceneFolder(args.target), args.read_only, args.backend)
    if args.http is None:
        if args.json:
            raise F4xError("--json prints on standard output, which belongs to the client here; leave it out.")
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing else wakes the thread that waits for input
        try:
            serve_stdio(session)
        except BaseExceptionGroup as group:  # of the package's tasks
            raise _reason(group) from group
        return {}
    token, is_new = read_token()

    def announce(url: str) -> None:
        print_error(url)
        print_error(f"Authorization: Bearer {token if is_new else '$F4X_TOKEN'}")

    serve_http(session, _address(args.http), token, announce)
    return {}


def _reason(error: BaseException) -> BaseException:
    """Return the first error of a group; one of standard output names it, and nothing more is written there."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    if not isinstance(error, OSError):
        return error
    discard(sys.stdout)
    return OSError(error.errno, error.strerror, OUTPUT)


def _address(text: str) -> tuple[str, int]:
    """Return (host, port) of `PORT` or `HOST:PORT`."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit()):
        raise F4xError(f"--http {text}: write a port, for example --http 8484.")
    from ..agent.server import LOOPBACK

    return host or LOOPBACK, int(port)
