"""The outcome of a check: one line for each rule, the offenders, and all of it as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

__all__ = ["MAX_EXCEPTIONS", "Exceptions", "Offender", "Report", "RuleResult"]

MAX_EXCEPTIONS: Final = 20_000
"""Broken values that are listed one by one for each rule; the rest is only counted."""


@dataclass(frozen=True, slots=True)
class Offender:
    """A model or file that breaks a rule.

    Parameters
    ----------
    subject : str
        Name of the model or path of the file.
    failed : int
        Number of its values beyond the limit.
    worst : float
        The one that is the largest multiple of its limit.
    limit : float
        That value's limit.
    where : str
        Where in the model that value is.
    """

    subject: str
    failed: int
    worst: float
    limit: float
    where: str

    @property
    def ratio(self) -> float:
        """How many times its limit the worst value is."""
        if math.isnan(self.worst) or self.limit == 0:
            return math.inf
        return self.worst / self.limit

    def merged(self, other: Offender) -> Offender:
        """Return the worse of two offences of one subject with the failures of both."""
        worse = self if self.ratio >= other.ratio else other
        return replace(worse, failed=self.failed + other.failed)


@dataclass(slots=True)
class Exceptions:
    """All values beyond a rule's limit, up to `MAX_EXCEPTIONS`."""

    subjects: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    total: int = 0

    @property
    def room(self) -> int:
        """How many more can be listed."""
        return MAX_EXCEPTIONS - len(self.values)

    def append(self, subject: str, place: str, value: float) -> None:
        """List one broken value."""
        self.subjects.append(subject)
        self.places.append(place)
        self.values.append(value)


@dataclass(frozen=True, slots=True)
class RuleResult:
    """What became of one rule.

    Parameters
    ----------
    name, description, limit, unit, share
        As in the rule.
    checked, failed : int
        Values measured, and those beyond their limit.
    excused : int
        Those of the failed ones that faults of the CAD file explain; see `Rule.source`.
    skipped : int
        Models on which it could not be measured because a rule it builds on is broken there.
    worst, worst_limit : float or None
        The value that is the largest multiple of its limit, and that limit; None if nothing
        was measured.
    offenders : tuple of Offender
        Every subject that breaks the rule, worst first.
    exceptions : Exceptions
        The broken values one by one.
    passed : bool
        Whether no more than the share `share` is broken, excused values aside.
    """

    name: str
    description: str
    limit: str
    unit: str
    share: float
    checked: int
    failed: int
    excused: int
    skipped: int
    worst: float | None
    worst_limit: float | None
    offenders: tuple[Offender, ...]
    exceptions: Exceptions
    passed: bool

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, fit for JSON."""
        return {
            "name": self.name,
            "description": self.description,
            "limit": self.limit,
            "unit": self.unit,
            "share": self.share,
            "checked": self.checked,
            "failed": self.failed,
            "excused": self.excused,
            "skipped": self.skipped,
            "worst": _finite(self.worst),
            "worst_limit": _finite(self.worst_limit),
            "passed": self.passed,
            "offenders": [
                {
                    "subject": o.subject,
                    "failed": o.failed,
                    "worst": _finite(o.worst),
                    "limit": _finite(o.limit),
                    "where": o.where,
                }
                for o in self.offenders
            ],
            "exceptions": [
                {"subject": subject, "where": where, "value": _finite(value)}
                for subject, where, value in zip(
                    self.exceptions.subjects,
                    self.exceptions.places,
                    self.exceptions.values,
                    strict=True,
                )
            ],
            "exceptions_total": self.exceptions.total,
        }


@dataclass(frozen=True, slots=True)
class Report:
    """The outcome of a check of a lake.

    Parameters
    ----------
    lake : str
        Where the lake is.
    snapshot : int
        Which snapshot was checked.
    models : int
        Number of models checked.
    rows : int
        Number of table rows read.
    seconds : float
        Wall time.
    rules : tuple of RuleResult
        One for each rule.
    """

    lake: str
    snapshot: int
    models: int
    rows: int
    seconds: float
    rules: tuple[RuleResult, ...]

    @property
    def ok(self) -> bool:
        """Whether every rule holds."""
        return all(rule.passed for rule in self.rules)

    @property
    def broken(self) -> tuple[RuleResult, ...]:
        """The rules that do not hold."""
        return tuple(rule for rule in self.rules if not rule.passed)

    def rule(self, name: str) -> RuleResult:
        """Return the result of the rule called `name`.

        Raises
        ------
        KeyError
            If there is no such rule.
        """
        for rule in self.rules:
            if rule.name == name:
                return rule
        raise KeyError(f"there is no rule {name}")

    def to_json(self, *, indent: int | None = 2) -> str:
        """Return the whole report as JSON, every listed exception included."""
        return json.dumps(
            {
                "lake": self.lake,
                "snapshot": self.snapshot,
                "models": self.models,
                "rows": self.rows,
                "seconds": round(self.seconds, 3),
                "ok": self.ok,
                "rules": [rule.to_dict() for rule in self.rules],
            },
            indent=indent,
        )

    def table(self) -> Table:
        """Return the table of rules for ``rich``."""
        from breplake.queries.check.show import rule_table

        return rule_table(self)

    def render(self, *, offenders: int = 5) -> Group:
        """Return table, offenders and verdict for ``rich``.

        Parameters
        ----------
        offenders : int
            How many to name for each rule.
        """
        from breplake.queries.check.show import full_report

        return full_report(self, offenders)


def _finite(value: float | None) -> float | str | None:
    """Return `value` as JSON can hold it: NaN and infinity become words."""
    return value if value is None or math.isfinite(value) else str(value)
