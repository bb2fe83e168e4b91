"""One request to an OpenAI-compatible server, by the standard library alone. Nothing is sent unless an address is given."""

from __future__ import annotations

import base64
import http.client
import json
import os
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from ..errors import F4xError

URL, KEY, MODEL = "F4X_CHAT_URL", "F4X_CHAT_KEY", "F4X_CHAT_MODEL"
"""Environment variables: base URL up to and with `/v1`, key, name of the model."""
MAX_ANSWER_BYTES = 1 << 20
"""Bytes of an answer that are read; more is no chat."""


class ChatError(F4xError):
    """A server did not answer as asked; `status` is its HTTP status, None where there was none."""

    def __init__(self, sentence: str, status: int | None = None):
        super().__init__(sentence)
        self.status = status


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A redirect would carry pictures and key to a server that nobody named."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        return None


@dataclass(frozen=True)
class ChatServer:
    """Server of a chat model: its address, model and key."""

    url: str
    """Base URL, for example http://127.0.0.1:8080/v1."""
    key: str = ""
    """Sent as bearer token when not empty."""
    model: str = "default"
    """Name of the model; local servers take any."""
    timeout: float = 120.0
    """Seconds without an answer after which it is given up."""

    def __post_init__(self) -> None:
        """Refuse what is no web address."""
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise F4xError(f"{self.url}: this is no address of a server; give one like http://127.0.0.1:8080/v1.")

    @classmethod
    def from_environment(cls, url: str | None = None, timeout: float = 120.0) -> ChatServer | None:
        """Return the server at `url`, or the one that the environment names; None where neither does."""
        url = url or os.environ.get(URL)
        if not url:
            return None
        return cls(url, os.environ.get(KEY, ""), os.environ.get(MODEL, "default"), timeout)

    def complete(self, messages: Sequence[dict[str, Any]], **more: Any) -> str:
        """Return the text of the answer to `messages`; `more` goes into the request. ChatError reports another outcome."""
        body = json.dumps({"model": self.model, "messages": list(messages), **more}).encode()
        headers = {"Content-Type": "application/json"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        request = urllib.request.Request(self.url.rstrip("/") + "/chat/completions", body, headers)
        late = f"{self.url}: no answer within {self.timeout:g} seconds; try again, or ask for less at once."
        end = time.monotonic() + self.timeout
        try:
            with urllib.request.build_opener(_NoRedirect).open(request, timeout=self.timeout) as reply:
                read = bytearray()
                while part := reply.read1(1 << 16):  # piece by piece: a server that drips would never time out
                    read += part
                    if len(read) > MAX_ANSWER_BYTES:
                        raise ChatError(
                            f"{self.url}: the server's answer is larger than {MAX_ANSWER_BYTES >> 20} MB; is it a chat?"
                        )
                    if time.monotonic() > end:
                        raise ChatError(late)
            text = json.loads(read)["choices"][0]["message"]["content"]
        except urllib.error.HTTPError as error:
            complaint = _complaint(error)
            hint = (
                "; it seems to read text only, start it with a model that sees pictures" if "image" in complaint else ""
            )
            raise ChatError(
                f"{self.url}: the server answered {error.code} ({complaint[:200] or error.reason}){hint}.", error.code
            ) from error
        except TimeoutError as error:
            raise ChatError(late) from error
        except (urllib.error.URLError, OSError, http.client.HTTPException) as error:
            reason = getattr(error, "reason", error)
            if isinstance(reason, TimeoutError):
                raise ChatError(late) from error
            raise ChatError(f"{self.url}: the server cannot be reached ({reason}); is it running?") from error
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise ChatError(
                f"{self.url}: the server's answer is not the JSON of a chat; is the address right?"
            ) from error
        if not isinstance(text, str) or not text.strip():
            raise ChatError(f"{self.url}: the server's answer is empty; ask again or choose another model.")
        return text.strip()


def _complaint(error: urllib.error.HTTPError) -> str:
    """Return the server's reason for a refusal, on one line; empty where it cannot be read."""
    try:
        return " ".join(error.read(MAX_ANSWER_BYTES).decode(errors="replace").split())
    except (OSError, http.client.HTTPException):
        return ""


def image_part(image: np.ndarray) -> dict[str, Any]:
    """Return `image (H,W,3)` uint8 as one part of a message's content."""
    from PIL import Image

    data = BytesIO()
    Image.fromarray(image).save(data, "PNG")
    return {
        "type": "image_url",
        "image_url": {"url": "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()},
    }
