"""YAML in the style of the published files: numbers in flow lists, all else in blocks.

PyYAML's dumper in C takes a second for what this writes in hundredths; both are read alike.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, Final

__all__ = ["yaml_text"]

_PER_LINE: Final = 8
"""Numbers on a line of a long list."""

_BARE: Final = re.compile(r"(?<![\d.])(\d+)e")
"""A float that YAML 1.1 would take for text: it wants a point in the mantissa."""

_NUMERIC: Final = {ord(sign): None for sign in "0123456789.e+-, []"}
"""All signs of lists of finite numbers, to be left out."""

_NUMBERS: Final = frozenset([int, float])
"""Types of nearly all items of long lists."""

_PLAIN: Final = re.compile(r"[A-Za-z][A-Za-z0-9_ .-]*[A-Za-z0-9_.-]|[A-Za-z]")
"""Text that needs no quotes, unless it is one of `_WORDS`."""

_WORDS: Final = frozenset(["true", "false", "yes", "no", "on", "off", "null", "y", "n"])


def yaml_text(data: Mapping[str, Any]) -> str:
    """Return a mapping as YAML, keys in order of their names.

    Parameters
    ----------
    data : mapping
        Of None, bool, int, float, str, lists and mappings, nested as they like.

    Returns
    -------
    str
        Floats are written so that reading them gives back every bit.

    Raises
    ------
    TypeError
        If a value is of another type.
    """
    return "".join(_mapping(data, "")) if data else "{}\n"


def _mapping(data: Mapping[str, Any], indent: str) -> Iterator[str]:
    for key in sorted(data):
        yield from _entry(f"{indent}{_text(key)}:", data[key], indent)


def _entry(head: str, value: Any, indent: str) -> Iterator[str]:
    """Write what follows a key."""
    if isinstance(value, Mapping) and value:
        yield f"{head}\n"
        yield from _mapping(value, indent + "  ")
    elif _is_block(value):
        # as PyYAML does, the items of a list stand under its key
        yield f"{head}\n"
        yield from _items(value, indent)
    else:
        yield f"{head} {_inline(value, indent)}\n"


def _items(values: list[Any], indent: str) -> Iterator[str]:
    """Write the items of a list that holds lists or mappings, each behind a dash."""
    dash = f"{indent}- "
    if (rows := _rows(values)) is not None:
        yield dash + rows.replace("], [", f"]\n{dash}[") + "\n"
        return
    for value in values:
        if isinstance(value, Mapping) and value:
            first, *rest = chain.from_iterable(
                _entry(f"{indent}  {_text(key)}:", value[key], indent + "  ")
                for key in sorted(value)
            )
            yield dash + first[len(dash) :]
            yield from rest
        elif _is_block(value):
            first, *rest = _items(value, indent + "  ")
            yield dash + first[len(dash) :]
            yield from rest
        else:
            yield f"{dash}{_inline(value, indent + '  ')}\n"


def _is_block(value: Any) -> bool:
    """Tell whether a list is to be written with dashes: any item of it is no scalar."""
    if not isinstance(value, list) or _NUMBERS.issuperset(map(type, value)):
        return False
    return any(isinstance(item, Mapping | list) for item in value)


def _rows(values: list[Any]) -> str | None:
    """Return short lists of numbers as ``[...], [...]``; None if there is anything else."""
    if not all(type(row) is list and 0 < len(row) <= _PER_LINE for row in values):
        return None
    text = _numbers(values)
    # a row that holds a list is none of numbers
    return None if text is None or text.count("[") > len(values) + 1 else text[1:-1]


def _inline(value: Any, indent: str) -> str:
    if isinstance(value, list):
        text = _numbers(value)
        words = text[1:-1].split(", ") if text else [_scalar(item) for item in value]
        lines = (", ".join(words[i : i + _PER_LINE]) for i in range(0, len(words), _PER_LINE))
        return "[" + f",\n{indent}  ".join(lines) + "]"
    return "{}" if isinstance(value, Mapping) else _scalar(value)


def _numbers(values: list[Any]) -> str | None:
    """Return a list of finite numbers, or of lists of them, as text; None if it is none.

    Python writes a whole list at once, and as YAML wants it but for floats like 1e-05.
    """
    text = repr(values)
    if text.translate(_NUMERIC):
        return None
    return _BARE.sub(r"\1.0e", text) if "e" in text else text


def _scalar(value: Any) -> str:
    if type(value) is float:  # the many; a subclass may print otherwise
        text = repr(value)
        return _BARE.sub(r"\1.0e", text) if math.isfinite(value) else _NOT_FINITE[text]
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if type(value) is int:
        return repr(value)
    if isinstance(value, str):
        return _text(value)
    raise TypeError(f"cannot write {type(value).__name__} as YAML: {value!r}")


_NOT_FINITE: Final = {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}


def _text(value: str) -> str:
    """Return text plain where it can be nothing else, otherwise in double quotes."""
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return '"' + "".join(map(_escaped, value)) + '"'


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    if character.isprintable() and character != "\ufeff":
        return character
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
