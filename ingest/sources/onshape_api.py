"""Onshape's REST API, with requests signed as its documentation prescribes.

The keys come from the environment only. The secret is never sent, logged or stored: it signs
each request by HMAC (https://onshape-public.github.io/docs/auth/apikeys).
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode, urlsplit

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import advise
from breplake.ingest.sources.web import Answer, Web

__all__ = ["Keys", "OnshapeApi", "base_address", "signature"]

ACCESS_VARIABLE: Final = "ONSHAPE_ACCESS_KEY"
SECRET_VARIABLE: Final = "ONSHAPE_SECRET_KEY"
BASE_VARIABLE: Final = "ONSHAPE_URL"

_BASE: Final = "https://cad.onshape.com"
_VERSION: Final = "v10"
_JSON: Final = "application/json"
_ACCEPT: Final = "application/json;charset=UTF-8; qs=0.09"
_BYTES: Final = "application/octet-stream"
_GONE: Final = (404, 410)
_LARGEST: Final = 64 * 2**20
"""Bytes of an answer in JSON, far beyond those of any document."""


def base_address() -> str:
    """Return the address of Onshape: ``$ONSHAPE_URL``, or that of its public server.

    Raises
    ------
    UsageError
        If it is neither https nor on this machine.
    """
    base = (os.environ.get(BASE_VARIABLE) or _BASE).rstrip("/")
    parts = urlsplit(base)
    if parts.scheme != "https" and parts.hostname not in ("127.0.0.1", "localhost", "::1"):
        raise UsageError(f"{BASE_VARIABLE} must start with https://, got {base!r}")
    return base


@dataclass(frozen=True, slots=True)
class Keys:
    """A pair of API keys. Neither shows up where it is printed.

    Parameters
    ----------
    access, secret : str
        As Onshape's developer portal gives them.
    """

    access: str = field(repr=False)
    secret: str = field(repr=False)

    @classmethod
    def from_environment(cls) -> Keys:
        """Return the keys of the environment.

        Raises
        ------
        UsageError
            If there are none.
        """
        access, secret = os.environ.get(ACCESS_VARIABLE), os.environ.get(SECRET_VARIABLE)
        if not access or not secret:
            raise UsageError(
                f"Onshape asks for API keys: set {ACCESS_VARIABLE} and {SECRET_VARIABLE} "
                "(https://cad.onshape.com/appstore/dev-portal makes them)"
            )
        return cls(access, secret)


def signature(
    keys: Keys, method: str, url: str, *, nonce: str, date: str, content_type: str
) -> str:
    """Return the header ``Authorization`` of a request.

    The signed text is, in lower case and each with a newline: method, nonce, date, content type,
    path, query (https://onshape-public.github.io/docs/auth/apikeys, "Request signature").

    Parameters
    ----------
    keys : Keys
        Who asks.
    method, url : str
        What is asked for.
    nonce : str
        At least 16 letters and digits, of this request alone.
    date : str
        The header ``Date``.
    content_type : str
        The header ``Content-Type``.
    """
    parts = urlsplit(url)
    lines = (method, nonce, date, content_type, parts.path, parts.query)
    text = "".join(f"{line}\n" for line in lines).lower()
    digest = hmac.digest(keys.secret.encode(), text.encode(), hashlib.sha256)
    return f"On {keys.access}:HmacSHA256:{base64.b64encode(digest).decode()}"


class OnshapeApi:
    """Calls of the API; safe to share between threads.

    Parameters
    ----------
    web : Web
        Sends the requests, and again where that may help.
    keys : Keys
        Who asks.
    base : str
        Address of the server.
    """

    def __init__(self, web: Web, keys: Keys, base: str) -> None:
        self._web, self._keys, self.base = web, keys, base
        self._spent = False

    def get(self, path: str, query: Mapping[str, str | int] | None = None) -> Any:
        """Return the JSON document at `path`, which starts behind the API's version.

        Raises
        ------
        InputError
            ``download-failed``: it does not exist, is private, or the server fails for good.
        UsageError
            If the keys are not accepted.
        """
        tail = f"?{urlencode(query)}" if query else ""
        return self._json(self._ask("GET", path + tail), path)

    def find(self, path: str) -> Any:
        """Return what `get` does, or None if it does not exist any more."""
        answer = self._ask("GET", path)
        return None if answer.status in _GONE else self._json(answer, path)

    def post(self, path: str, body: Mapping[str, Any]) -> Any:
        """Send `body` in JSON to `path` and return the JSON answer; raises what `get` does."""
        return self._json(self._ask("POST", path, body=json.dumps(body).encode()), path)

    def download(self, path: str, into: Path, most: int) -> bool:
        """Write the bytes at `path` to a file; return False if there are none any more.

        Raises
        ------
        InputError
            ``download-failed`` or ``too-large``.
        UsageError
            If the keys are not accepted.
        """
        answer = self._ask("GET", path, accept=_BYTES, into=into, most=most)
        if answer.status in _GONE:
            return False
        self._check(answer, path)
        return True

    def _ask(
        self,
        method: str,
        path: str,
        *,
        body: bytes | None = None,
        accept: str = _ACCEPT,
        into: Path | None = None,
        most: int = _LARGEST,
    ) -> Answer:
        if self._spent:
            raise _failed(path, "the calls of your Onshape plan are used up")
        return self._web.ask(
            method,
            f"{self.base}/api/{_VERSION}{path}",
            body=body,
            headers={"Accept": accept},
            sign=self._sign,
            into=into,
            most=most,
        )

    def _sign(self, method: str, url: str) -> Mapping[str, str]:
        """Return the headers that prove who asks; none for servers that are not Onshape's."""
        host, home = urlsplit(url).hostname or "", urlsplit(self.base).hostname
        if host != home and not host.endswith(".onshape.com"):
            return {}
        nonce, date = secrets.token_hex(16), formatdate(usegmt=True)
        proof = signature(self._keys, method, url, nonce=nonce, date=date, content_type=_JSON)
        return {"Date": date, "On-Nonce": nonce, "Content-Type": _JSON, "Authorization": proof}

    def _json(self, answer: Answer, path: str) -> Any:
        self._check(answer, path)
        try:
            return json.loads(answer.data)
        except ValueError as error:
            raise _failed(path, "the answer is no JSON") from error

    def _check(self, answer: Answer, path: str) -> None:
        if answer.status == 401:
            raise UsageError(
                f"Onshape does not accept the keys in {ACCESS_VARIABLE} and {SECRET_VARIABLE}; "
                "they are made for one server, and can be withdrawn"
            )
        if answer.status == 402:
            self._spent = True
            raise _failed(path, "the calls of your Onshape plan are used up")
        if answer.status != 200:
            why = {403: ", the keys do not allow it", 404: ", it is private or gone"}
            raise _failed(path, f"the server answers {answer.status}{why.get(answer.status, '')}")


def _failed(path: str, detail: str) -> InputError:
    place = path.partition("?")[0]
    return InputError("download-failed", advise("download-failed", f"Onshape {place}: {detail}"))
