"""Faults put into STEP files, as a pure function of the text, the fault and a generator."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from typing import Final

__all__ = ["FAULTS", "mutated"]

_NUMBER: Final = re.compile(rb"-?\d+\.\d*(?:E[+-]?\d+)?")
_REFERENCE: Final = re.compile(rb"#\d+")
_ENTITY: Final = re.compile(rb"^#\d+\s*=[^;]*;", re.MULTILINE)


def _truncated(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) // 10, len(data))]


def _flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 10, 100))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _replaced(
    data: bytes, pattern: re.Pattern[bytes], text: list[bytes], n: int, rng: random.Random
) -> bytes:
    """Put one of `text` in place of `n` random matches."""
    found = list(pattern.finditer(data))
    chosen = {match.start(): match.end() for match in rng.sample(found, min(n, len(found)))}
    pieces, end = [], 0
    for start in sorted(chosen):
        pieces += [data[end:start], rng.choice(text)]
        end = chosen[start]
    return b"".join([*pieces, data[end:]])


def _numbers(data: bytes, rng: random.Random) -> bytes:
    text = [b"0.", b"-1.", b"1.E-9", b"123456.789", b"-0.3333333"]
    return _replaced(data, _NUMBER, text, rng.choice((1, 5, 50)), rng)


def _references(data: bytes, rng: random.Random) -> bytes:
    text = [b"#1", b"#999999999", b"#0", rng.choice(_REFERENCE.findall(data)), b"$", b"*"]
    return _replaced(data, _REFERENCE, text, rng.choice((1, 5, 50)), rng)


def _swapped(data: bytes, rng: random.Random) -> bytes:
    """Let two entities change their contents."""
    found = _ENTITY.findall(data)
    for _ in range(rng.choice((1, 5, 20))):
        (a, x), (b, y) = (line.split(b"=", 1) for line in rng.sample(found, 2))
        data = data.replace(a + b"=" + x, a + b"=" + y, 1).replace(b + b"=" + y, b + b"=" + x, 1)
    return data


def _not_a_number(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _NUMBER, [b"NaN", b"nan", b"INF", b"-INF"], rng.choice((1, 10)), rng)


def _huge(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _NUMBER, [b"1.E300", b"-1.E300", b"1.E999"], rng.choice((1, 10)), rng)


def _nested(data: bytes, rng: random.Random) -> bytes:
    """Put a list of lists where a number was, deeper than any stack."""
    depth = rng.choice((1000, 200_000))
    return _replaced(data, _NUMBER, [b"(" * depth + b")" * depth], 1, rng)


def _lost(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _ENTITY, [b""], rng.choice((1, 5, 50)), rng)


FAULTS: Final[dict[str, Callable[[bytes, random.Random], bytes]]] = {
    "truncated": _truncated,
    "flipped": _flipped,
    "numbers": _numbers,
    "references": _references,
    "swapped": _swapped,
    "nan": _not_a_number,
    "huge": _huge,
    "nested": _nested,
    "lost": _lost,
}


def mutated(data: bytes, fault: str, seed: int) -> bytes:
    """Return a STEP file with a fault; equal arguments give equal bytes.

    Parameters
    ----------
    data : bytes
        The file.
    fault : str
        One of `FAULTS`.
    seed : int
        Chooses where, and how much.
    """
    return FAULTS[fault](data, random.Random(f"{fault} {seed}"))
