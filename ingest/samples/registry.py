"""The list of sample parts: one small function each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

Unit = Literal["mm", "inch"]
Builder = Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Part:
    """A sample part: what it is called, what it is, and how it is modelled.

    Attributes
    ----------
    name : str
        Unique name, also the stem of the STEP file.
    description : str
        One line for people.
    build : Callable
        Makes the model in millimetres: a cadquery Workplane, Shape or Assembly.
    unit : {"mm", "inch"}
        Length unit that the STEP file declares; its numbers are in this unit.
    is_open : bool
        Whether the model is meant to have free edges (surfaces without a solid).
    """

    name: str
    description: str
    build: Builder
    unit: Unit = "mm"
    is_open: bool = False


PARTS: dict[str, Part] = {}
"""Every sample part by name, in the order in which they are defined."""


def part(
    name: str, description: str, *, unit: Unit = "mm", is_open: bool = False
) -> Callable[[Builder], Builder]:
    """Register the decorated function as the sample part ``name``.

    Parameters
    ----------
    name : str
        Unique name; a second part of the same name is an error.
    description : str
        One line for people.
    unit : {"mm", "inch"}
        Length unit of the STEP file.
    is_open : bool
        Whether the model is meant to have free edges.

    Returns
    -------
    Callable
        The decorator, which leaves the function as it is.
    """

    def register(build: Builder) -> Builder:
        if name in PARTS:
            raise ValueError(f"a sample part named {name!r} exists already; names are unique")
        PARTS[name] = Part(name, description, build, unit, is_open)
        return build

    return register
