"""YAML of the published files, read quickly.

A features file is a megabyte of numbers in lists. LibYAML makes an event of each and takes two
seconds; JSON reads the same lists in hundredths. So lists of plain numbers are cut out, read as
JSON, and put back where YAML has read the rest.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

import yaml  # type: ignore[import-untyped]

from breplake.errors import InputError
from breplake.ingest.failure import advise

__all__ = ["parse_yaml", "read_yaml"]

_FLOW: Final = r"\[[-+0-9.eE,\s]*\]"
"""A list of numbers between brackets, over several lines perhaps."""

_BLOCK: Final = re.compile(rf"(?<=:)\n(?P<rows>(?:[ ]*(?:-[ ])+{_FLOW}[ ]*\n)+)")
"""Such lists behind dashes, one or two deep, as the value of a key."""

_LIST: Final = re.compile(rf"(?<=[:-][ ]){_FLOW}(?=[ ]*\n)")
_ROW: Final = re.compile(rf"(?P<dashes>[ ]*(?:-[ ])+)(?P<values>{_FLOW})[ ]*\n")

_TAG: Final = "!breplake-numbers"

_BASE: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_yaml(path: Path, kind: str = "bad-features") -> Any:
    """Read a YAML file.

    Raises
    ------
    InputError
        `kind` if it is no text or no YAML.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        said = " ".join(str(error).split())
        raise InputError(kind, advise(kind, f"{path.name} cannot be read: {said}")) from error


def parse_yaml(text: str) -> Any:
    """Return what ``yaml.safe_load`` returns, ten to thirty times as fast on lists of numbers."""
    lists: list[Any] = []

    def keep(values: Any) -> str:
        lists.append(values)
        return f"{_TAG} {len(lists) - 1}"

    def block(match: re.Match[str]) -> str:
        values = _nested(match["rows"])
        return match[0] if values is None else f" {keep(values)}\n"

    def flow(match: re.Match[str]) -> str:
        values = _numbers(match[0])
        return match[0] if values is None else keep(values)

    rest = _LIST.sub(flow, _BLOCK.sub(block, text if text.endswith("\n") else text + "\n"))
    used = 0

    class Loader(_BASE):  # type: ignore[misc,valid-type]
        """Puts the lists back."""

    def restore(_: Any, node: Any) -> Any:
        nonlocal used
        used += 1
        return lists[int(node.value)]

    Loader.add_constructor(_TAG, restore)
    found = yaml.load(rest, Loader)
    # inside a quoted text nothing is put back: then it was no list that was cut out
    return found if used == len(lists) else yaml.load(text, _BASE)


def _numbers(text: str) -> Any:
    """Return a list of numbers that JSON and YAML read alike, else None."""
    try:
        return json.loads(text)
    except ValueError:
        return None


def _nested(rows: str) -> Any:
    """Return lists behind dashes as a list of lists, one deep or two; None for other forms."""
    found = _ROW.findall(rows)
    opening = found[0][0]
    depth = opening.count("-")
    inner = opening.replace("-", " ", depth - 1)  # the rows that go on with a list
    if depth > 2 or any(dashes not in (opening, inner) for dashes, _ in found):
        return None
    if depth == 1:
        return _numbers("[" + ",".join(values for _, values in found) + "]")
    text = "".join(("],[" if d == opening else ",") + values for d, values in found)
    return _numbers("[[" + text[3:] + "]]")
