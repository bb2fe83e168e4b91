"""A chat server on the loopback that answers what a test wants and keeps what it was asked."""

import json
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

from f4x_core.query.chat import ChatServer


def saying(text):
    """The body of an answer with this text."""
    return {"choices": [{"message": {"content": text}}]}


@contextmanager
def stub_server():
    """The server; its `reply` is (status, body, seconds to wait), or a function of the request's JSON that gives it."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            self.server.asked.append((self.path, dict(self.headers), body))
            reply = self.server.reply
            status, answer, wait = reply(body) if callable(reply) else reply
            time.sleep(wait)
            try:
                self.send_response(status)
                if status == 307:
                    self.send_header("Location", "http://127.0.0.1:9/v1/chat/completions")
                self.end_headers()
                self.wfile.write(answer if isinstance(answer, bytes) else json.dumps(answer).encode())
            except OSError:  # the client has given up
                pass

        def log_message(self, *args):
            pass

    stub = HTTPServer(("127.0.0.1", 0), Handler)
    stub.asked, stub.reply = [], (200, saying("Hello."), 0)
    thread = threading.Thread(target=stub.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield stub
    finally:
        stub.shutdown()
        thread.join()
        stub.server_close()


def client(stub, **more):
    """A `ChatServer` for the stub."""
    return ChatServer(f"http://127.0.0.1:{stub.server_address[1]}/v1", **more)
