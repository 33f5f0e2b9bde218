"""Rules as data: what is measured, the limit it must keep, and where it did not."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from breplake.queries.check.report import Exceptions, Offender, RuleResult

if TYPE_CHECKING:
    from breplake.queries.check.files import LakeView
    from breplake.queries.check.view import ModelView

__all__ = [
    "LAKE_RULES",
    "MODEL_RULES",
    "Measure",
    "Rule",
    "Tally",
    "lake_rule",
    "model_rule",
    "place",
]

Where = Callable[[int], str]


def place(template: str, *columns: Any, **words: Any) -> Where:
    """Return a function that puts index and columns into a template.

    Parameters
    ----------
    template : str
        As for `str.format`: ``{i}`` is the index, ``{0}`` the value of the first column there.
    *columns : sequence
        Indexed by the index.
    **words : object
        Named fields, the same for every index.
    """

    def where(index: int) -> str:
        return template.format(*(column[index] for column in columns), i=index, **words)

    return where


@dataclass(frozen=True, slots=True)
class Measure:
    """Values that a rule measured, each with the limit it must not pass.

    Parameters
    ----------
    values : numpy.ndarray
        ``(n,)`` float64; NaN fails, so that nothing undefined can pass unseen.
    limits : numpy.ndarray or float
        ``(n,)`` or one for all.
    where : callable
        Turns an index into words: ``patch 3, row 17``.
    subject : str, optional
        Whose values these are when a lake rule measures: a file or a model.
    """

    values: NDArray[np.float64]
    limits: NDArray[np.float64] | float
    where: Where
    subject: str = ""

    @classmethod
    def of_truth(cls, ok: Any, where: Where, subject: str = "") -> Measure:
        """Measure statements: true is 0, false is 1, the limit 0."""
        return cls(1.0 - np.asarray(ok, dtype=np.float64), 0.0, where, subject)


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule of ``breplake check``.

    Parameters
    ----------
    name : str
        Stable, kebab case.
    description : str
        What must hold, one line.
    limit : str
        The limit in words or as a number.
    unit : str
        Unit of the measured values; empty for a count or a statement.
    share : float
        Share of the checked values that may break the limit (they are all listed).
    source : bool
        Whether faults of the CAD file itself can break it. Models that Open CASCADE finds
        invalid, or whose pcurves had to be made up, are then listed but do not count.
    needs : tuple of str
        Rules that must hold on a model before this one can be measured on it.
    measure : callable
        Yields the measures of one model, or of the lake.
    """

    name: str
    description: str
    limit: str
    unit: str
    share: float
    source: bool
    needs: tuple[str, ...]
    measure: Callable[[Any], Iterable[Measure]]


MODEL_RULES: dict[str, Rule] = {}
"""Rules measured on one model after the other, in the order of their definition."""

LAKE_RULES: dict[str, Rule] = {}
"""Rules measured once, on the files and on what spans models."""


def model_rule(
    name: str,
    description: str,
    *,
    limit: str = "none",
    unit: str = "",
    share: float = 0.0,
    source: bool = False,
    needs: tuple[str, ...] = (),
) -> Callable[[Callable[[ModelView], Iterable[Measure]]], Callable[[ModelView], Iterable[Measure]]]:
    """Register a function that measures one model; see `Rule` for the arguments."""

    def register(
        measure: Callable[[ModelView], Iterable[Measure]],
    ) -> Callable[[ModelView], Iterable[Measure]]:
        MODEL_RULES[name] = Rule(name, description, limit, unit, share, source, needs, measure)
        return measure

    return register


def lake_rule(
    name: str, description: str, *, limit: str = "none", unit: str = ""
) -> Callable[[Callable[[LakeView], Iterable[Measure]]], Callable[[LakeView], Iterable[Measure]]]:
    """Register a function that measures the whole lake; see `Rule` for the arguments."""

    def register(
        measure: Callable[[LakeView], Iterable[Measure]],
    ) -> Callable[[LakeView], Iterable[Measure]]:
        LAKE_RULES[name] = Rule(name, description, limit, unit, 0.0, False, (), measure)
        return measure

    return register


@dataclass(slots=True)
class Tally:
    """What a rule has measured so far."""

    rule: Rule
    checked: int = 0
    failed: int = 0
    excused: int = 0
    skipped: int = 0
    worst: float = 0.0
    worst_limit: float = 0.0
    worst_ratio: float = -1.0
    offenders: dict[str, Offender] = field(default_factory=dict)
    exceptions: Exceptions = field(default_factory=Exceptions)

    def add(self, measure: Measure, subject: str, *, faulty: bool = False) -> bool:
        """Count `measure`; return whether all its values keep their limits.

        What breaks in a model whose file is `faulty` is excused where the rule says so.
        """
        subject = measure.subject or subject
        values = np.asarray(measure.values, dtype=np.float64)
        if not len(values):
            return True
        limits = np.broadcast_to(np.asarray(measure.limits, dtype=np.float64), values.shape)
        ratio = _ratio(values, limits)
        broken = np.flatnonzero(~(values <= limits))
        self.checked += len(values)
        self.failed += len(broken)
        self.excused += len(broken) if faulty and self.rule.source else 0
        top = int(np.argmax(ratio))
        if ratio[top] > self.worst_ratio:
            self.worst, self.worst_limit = float(values[top]), float(limits[top])
            self.worst_ratio = float(ratio[top])
        if not len(broken):
            return True
        self._blame(subject, values, limits, broken, top, measure.where)
        return False

    def _blame(
        self,
        subject: str,
        values: NDArray[np.float64],
        limits: NDArray[np.float64],
        broken: NDArray[np.intp],
        top: int,
        where: Where,
    ) -> None:
        worst = Offender(subject, len(broken), float(values[top]), float(limits[top]), where(top))
        known = self.offenders.get(subject)
        self.offenders[subject] = worst if known is None else known.merged(worst)
        for index in broken[: self.exceptions.room]:
            self.exceptions.append(subject, where(int(index)), float(values[index]))
        self.exceptions.total += len(broken)

    def result(self) -> RuleResult:
        """Return the rule's line of the report."""
        allowed = self.rule.share * self.checked
        worst_first = sorted(self.offenders.values(), key=lambda o: (-o.ratio, o.subject))
        return RuleResult(
            name=self.rule.name,
            description=self.rule.description,
            limit=self.rule.limit,
            unit=self.rule.unit,
            share=self.rule.share,
            checked=self.checked,
            failed=self.failed,
            excused=self.excused,
            skipped=self.skipped,
            worst=self.worst if self.checked else None,
            worst_limit=self.worst_limit if self.checked else None,
            offenders=tuple(worst_first),
            exceptions=self.exceptions,
            passed=self.failed - self.excused <= allowed,
        )


def _ratio(values: NDArray[np.float64], limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how many times each value is its limit; NaN counts as infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(limits > 0, values / limits, np.where(values > 0, np.inf, 0.0))
    return np.where(np.isnan(values), np.inf, ratio)
