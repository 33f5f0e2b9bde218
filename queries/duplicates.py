"""Which models of a lake are copies of each other, and in what way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from breplake.schema.fingerprint import Fingerprint, mirrored

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["Duplicates", "Group", "find_duplicates"]

_MODELS: Final = """
SELECT model_id, collection || '/' || name AS name, sha256, fingerprint, duplicate_group
FROM models ORDER BY collection, name
"""


@dataclass(frozen=True, slots=True)
class Group:
    """Models of one shape and size, wherever they lie.

    Parameters
    ----------
    number : int
        ``duplicate_group``.
    models : tuple of (int, str)
        model_id and name, sorted by name.
    n_files : int
        Distinct files among them: 1 if all have the same bytes.
    mirrors, scaled : tuple of int
        Numbers of groups that are its mirror image, or the same in another size.
    """

    number: int
    models: tuple[tuple[int, str], ...]
    n_files: int
    mirrors: tuple[int, ...] = ()
    scaled: tuple[int, ...] = ()

    @property
    def explanation(self) -> str:
        """Say in words what the group's models share."""
        if len(self.models) == 1:
            return "one model"
        if self.n_files == 1:
            return "the same file"
        what = "the same shape and size"
        return what if self.n_files == len(self.models) else f"{what}, of {self.n_files} files"


@dataclass(frozen=True, slots=True)
class Duplicates:
    """The groups of a lake.

    Parameters
    ----------
    groups : tuple of Group
        Those of several models, and those that mirror or scale another; the largest first.
    n_models : int
        Models of the lake.
    """

    groups: tuple[Group, ...]
    n_models: int

    @property
    def n_copies(self) -> int:
        """Models that could go without a shape being lost."""
        return sum(len(group.models) - 1 for group in self.groups)


def find_duplicates(lake: Lake) -> Duplicates:
    """Group the models of a snapshot by shape.

    Mirror images and scaled copies are groups of their own, which name each other.
    """
    rows = lake.sql(_MODELS).fetchall()
    members: dict[int, list[tuple[int, str]]] = {}
    files: dict[int, set[str]] = {}
    shape: dict[int, Fingerprint] = {}
    for model_id, name, sha256, fingerprint, group in rows:
        members.setdefault(group, []).append((model_id, name))
        files.setdefault(group, set()).add(sha256)
        if fingerprint is not None:
            shape[group] = Fingerprint.parse(fingerprint)
    of_form: dict[str, list[int]] = {}
    for group, found in shape.items():
        of_form.setdefault(found.form, []).append(group)
    groups = []
    for number, models in members.items():
        mirrors, scaled = _relatives(number, shape, of_form)
        if len(models) > 1 or mirrors or scaled:
            groups.append(Group(number, tuple(models), len(files[number]), mirrors, scaled))
    groups.sort(key=lambda group: (-len(group.models), group.models[0][1]))
    return Duplicates(tuple(groups), len(rows))


def _relatives(
    number: int, shape: dict[int, Fingerprint], of_form: dict[str, list[int]]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the groups that mirror a group, and those that scale it."""
    own = shape.get(number)
    if own is None:
        return (), ()
    others = [(other, shape[other]) for other in of_form[own.form] if other != number]
    opposite = mirrored(own.hand)
    mirrors = [n for n, f in others if f.size == own.size and f.hand == opposite != own.hand]
    scaled = [n for n, f in others if f.size != own.size and f.hand == own.hand]
    return tuple(sorted(mirrors)), tuple(sorted(scaled))
