"""HTTP with back-off: what fails for now is tried again, as often and as late as servers ask."""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Iterator, Mapping
from http.client import HTTPException
from pathlib import Path
from typing import Any, Final
from urllib.parse import urljoin, urlsplit

from breplake.errors import InputError, MissingExtraError
from breplake.ingest.failure import advise

__all__ = ["USER_AGENT", "Web", "download_failed", "need_urllib3", "public_address"]

USER_AGENT: Final = "breplake"
"""How requests introduce themselves."""

_BLOCK: Final = 2**20
_TIMEOUT: Final = 60.0
"""Seconds without a byte after which a connection counts as lost."""

_AGAIN: Final = frozenset({408, 425, 429, 499, 500, 502, 503, 504})
"""Answers that may be better later."""

_PATIENCE: Final = 300.0
"""Seconds after which an address is given up, and the longest that a server may ask to wait."""

_ATTEMPTS: Final = 8
_REDIRECTS: Final = 5

Headers = Mapping[str, str]
Sign = Callable[[str, str], Headers]
"""Gives the headers that prove who asks, for a method and an address."""


def need_urllib3() -> Any:
    """Return the module ``urllib3``.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import urllib3
    except ImportError as error:
        raise MissingExtraError("sources", "downloading") from error
    return urllib3


def public_address(uri: str) -> str:
    """Return a URI without user, query and fragment, which may hold secrets."""
    parts = urlsplit(uri)
    host = parts.netloc.rpartition("@")[2]
    return parts._replace(netloc=host, query="", fragment="").geturl()


class Web:
    """A client for HTTP, safe to share between threads.

    Parameters
    ----------
    backoff : float
        Seconds before the second repetition; each further one waits twice as long. The first
        comes at once. Where a server says how long to wait, that is obeyed, up to five minutes.
    wait : callable
        Waits some seconds.
    check : callable
        Asked often; it raises what is to end a request.
    """

    def __init__(
        self,
        backoff: float = 1.0,
        wait: Callable[[float], None] = time.sleep,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._wait, self._check = wait, check
        urllib3 = need_urllib3()
        self._errors = urllib3.exceptions
        self._pool = urllib3.PoolManager(
            maxsize=16,
            timeout=urllib3.Timeout(connect=_TIMEOUT, read=_TIMEOUT),
            headers={"User-Agent": USER_AGENT, "Accept-Encoding": "identity"},
        )
        self._retry = urllib3.Retry(
            total=_ATTEMPTS,
            redirect=_REDIRECTS,
            allowed_methods=None,
            backoff_factor=backoff,
            backoff_jitter=backoff / 4,
        )

    def close(self) -> None:
        """Close all connections."""
        self._pool.clear()

    def ask(
        self,
        method: str,
        url: str,
        *,
        body: bytes | None = None,
        headers: Headers | None = None,
        sign: Sign | None = None,
        into: Path | None = None,
        most: int | None = None,
    ) -> Answer:
        """Send a request until there is an answer that counts, for five minutes at most.

        What cannot be better later is not tried again: an address that is none, a host that has
        no address, a certificate that is not valid.

        Parameters
        ----------
        method, url : str
            What is asked for.
        body : bytes, optional
            What is sent along.
        headers : mapping, optional
            In addition to the usual ones.
        sign : callable, optional
            Asked for more headers before each attempt, and after a redirection for the new address.
        into : Path, optional
            File for the body of a good answer, which is else kept in memory.
        most : int, optional
            Bytes of the largest body that is taken.

        Raises
        ------
        InputError
            ``download-failed`` if there is no answer in the end, ``too-large`` if it is too large.
        """
        retry, target = self._retry, url
        end = time.monotonic() + _PATIENCE
        while True:
            self._check()
            response, error = None, None
            try:
                proof = sign(method, target) if sign else {}
                response = self._send(method, target, body, {**(headers or {}), **proof})
                if not _is_excuse(response):
                    return Answer.read(response, into, most, _is_packed(url), self._check)
                # Its body may have no end, so the connection is not used again.
                response.close()
                response.release_conn()
            except self._errors.HTTPError as caught:
                response, error = None, caught
                self._require_passing(url, caught)
            except InputError:
                raise
            except (ValueError, HTTPException) as caught:  # of parts that no request can hold
                raise _no_address(url, caught) from caught
            self._check()
            try:
                retry = retry.increment(method, target, response=response, error=error)
            except self._errors.MaxRetryError as last:
                raise download_failed(url, str(last.reason)) from last
            if response is not None and (there := response.get_redirect_location()):
                target = _redirected(target, there)
            else:
                self._wait(_pause(retry, response, error, url, end))

    def _require_passing(self, url: str, error: Exception) -> None:
        """Raise the failure of an address whose error will be the same next time."""
        if isinstance(error, ValueError):
            raise _no_address(url, error) from error
        if self._is_final(error):
            raise download_failed(url, str(error)) from error

    def _is_final(self, error: Exception) -> bool:
        """Whether an error will be the same next time."""
        if isinstance(error, self._errors.NameResolutionError):
            return True
        cause = error.args[0] if error.args else None
        return isinstance(cause, ssl.SSLCertVerificationError)

    def _send(self, method: str, url: str, body: bytes | None, headers: Headers) -> Any:
        return self._pool.request(
            method,
            url,
            body=body,
            headers={**self._pool.headers, **headers},
            redirect=False,
            retries=False,
            preload_content=False,
        )


class Answer:
    """An answer that counts: neither a redirection nor an excuse.

    Attributes
    ----------
    status : int
        Its code.
    headers : mapping
        Its headers, in any case.
    data : bytes
        Its body, if it was not written to a file.
    """

    def __init__(self, status: int, headers: Headers, data: bytes) -> None:
        self.status, self.headers, self.data = status, headers, data

    @classmethod
    def read(
        cls,
        response: Any,
        into: Path | None,
        most: int | None,
        packed: bool,
        check: Callable[[], None],
    ) -> Answer:
        """Read a response to its end.

        Parameters
        ----------
        response : urllib3.BaseHTTPResponse
            What came.
        into, most
            See :meth:`Web.ask`.
        packed : bool
            Whether the file itself is compressed: a server that calls this an encoding of the
            transfer means the same compression.
        check : callable
            Asked often; it raises what is to end the reading.
        """
        data = b""
        try:
            if into is None or response.status != 200:
                data = b"".join(_limited(response, most, packed, check))
            else:
                with into.open("wb") as file:
                    file.writelines(_limited(response, most, packed, check))
        except BaseException:
            response.close()  # what is left of the body would be taken for the next answer
            raise
        return cls(response.status, response.headers, data)


def _limited(
    response: Any, most: int | None, packed: bool, check: Callable[[], None]
) -> Iterator[bytes]:
    size = 0
    for block in response.stream(_BLOCK, decode_content=not packed):
        check()
        size += len(block)
        if most is not None and size > most:
            raise InputError("too-large", advise("too-large", f"more than {most} bytes"))
        yield block


def _is_excuse(response: Any) -> bool:
    """Whether a response is a redirection, or an answer that may be better later."""
    return bool(response.get_redirect_location()) or response.status in _AGAIN


def _pause(retry: Any, response: Any, error: Exception | None, url: str, end: float) -> float:
    """Return the seconds to wait before the next try.

    Raises
    ------
    InputError
        ``download-failed`` if it would come after `end`, on the clock of ``time.monotonic``.
    """
    asked = retry.get_retry_after(response) if response is not None else None
    pause: float = asked or retry.get_backoff_time()
    if time.monotonic() + pause > end:
        why = error or f"the server answers {response.status if response else ''}"
        detail = f"{why}, and the next try, in {pause:.0f} s, is too late"
        raise download_failed(url, detail)
    return pause


def _no_address(url: str, error: Exception) -> InputError:
    # The error's own text may hold the address with its query.
    return download_failed(url, f"it is no address that can be asked ({type(error).__name__})")


def _is_packed(url: str) -> bool:
    return urlsplit(url).path.lower().endswith(".gz")


def _redirected(origin: str, there: str) -> str:
    target = urljoin(origin, there)
    before, after = urlsplit(origin).scheme, urlsplit(target).scheme
    if after not in ("http", "https") or (before == "https" and after == "http"):
        raise download_failed(
            origin, f"it redirects from {before} to {after}, which is not followed"
        )
    return target


def download_failed(url: str, detail: str) -> InputError:
    """Return the error of an address that cannot be had, without what in it may be secret."""
    message = advise("download-failed", f"{public_address(url)}: {detail}")
    return InputError("download-failed", message)
