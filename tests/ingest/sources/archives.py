"""What the archives of these tests hold."""

from __future__ import annotations

import gzip
import random

FORMATS = (".zip", ".tar", ".tar.gz", ".tar.bz2", ".tar.xz", ".tar.zst", ".7z")


def noise(seed: int, size: int = 3000) -> bytes:
    return random.Random(seed).randbytes(size)


FILES = {
    "parts/b.step": noise(1),
    "parts/a.STP": noise(2, 2_500_000),  # more than one block
    "readme.txt": b"no CAD file",
    "parts/deep/c.igs.gz": gzip.compress(noise(3)),
    "nested.zip": b"PK, which is not opened",
    "parts/b.stp": noise(4),
    "empty.brep": b"",
}
CAD = {name for name in FILES if name not in ("readme.txt", "nested.zip")}

MANY = {f"{i:03d}.step": noise(i, 2000) for i in range(60)}


def by_member(inputs):
    return {item.shown.partition("!/")[2]: item for item in inputs}
