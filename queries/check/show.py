"""A check report as it is printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from breplake.queries.check.report import Report, RuleResult

__all__ = ["full_report", "rule_table"]


def rule_table(report: Report) -> Table:
    """Return one line for each rule: what, how many, worst, limit and whether it holds."""
    table = Table(title=f"check of {report.lake}, snapshot {report.snapshot}", title_justify="left")
    table.add_column("rule", no_wrap=True)
    table.add_column("checked", justify="right", no_wrap=True)
    table.add_column("failed", justify="right", no_wrap=True)
    table.add_column("worst", justify="right", no_wrap=True)
    table.add_column("limit")
    table.add_column("", justify="center", no_wrap=True)
    for rule in report.rules:
        table.add_row(
            rule.name,
            f"{rule.checked:,}",
            _failed(rule),
            _worst(rule),
            _limit(rule),
            _mark(rule),
        )
    return table


def full_report(report: Report, offenders: int) -> Group:
    """Return the table, the worst `offenders` of each rule and the verdict."""
    parts: list[Table | Text] = [rule_table(report)]
    for rule in report.rules:
        if rule.offenders:
            parts.append(_offender_table(rule, offenders))
    parts.append(_verdict(report))
    return Group(*parts)


def _offender_table(rule: RuleResult, count: int) -> Table:
    word = "allowed exceptions" if rule.passed else "broken"
    table = Table(title=f"{rule.name}: {rule.description} ({word})", title_justify="left")
    table.add_column("model or file")
    table.add_column("failed", justify="right", no_wrap=True)
    table.add_column("worst", justify="right", no_wrap=True)
    table.add_column("limit", justify="right", no_wrap=True)
    table.add_column("where")
    for offender in rule.offenders[:count]:
        table.add_row(
            Text(offender.subject),
            f"{offender.failed:,}",
            _number(offender.worst),
            _number(offender.limit),
            Text(offender.where),
        )
    if len(rule.offenders) > count:
        table.caption = f"and {len(rule.offenders) - count} more; the JSON report has all"
    return table


def _verdict(report: Report) -> Text:
    what = f"{report.models:,} models, {report.rows:,} rows in {report.seconds:.1f} s"
    if report.ok:
        return Text(f"All {len(report.rules)} rules hold: {what}.", style="green")
    names = ", ".join(rule.name for rule in report.broken)
    return Text(
        f"{len(report.broken)} of {len(report.rules)} rules broken ({names}): {what}.", "red"
    )


def _mark(rule: RuleResult) -> Text:
    if not rule.passed:
        return Text("✗", style="bold red")
    if not rule.checked:
        return Text("–", style="dim")
    return Text("✓", style="green")


def _failed(rule: RuleResult) -> str:
    skipped = f" (+{rule.skipped} models skipped)" if rule.skipped else ""
    excused = f" ({rule.excused:,} in faulty files)" if rule.excused else ""
    return f"{rule.failed:,}{excused}{skipped}"


def _worst(rule: RuleResult) -> str:
    if rule.worst is None:
        return ""
    return f"{_number(rule.worst)} {rule.unit}".rstrip()


def _limit(rule: RuleResult) -> str:
    limit = rule.limit if rule.limit != "none" else "no exception"
    return f"{limit}; {1 - rule.share:.1%} of them" if rule.share else limit


def _number(value: float) -> str:
    if math.isfinite(value) and value == int(value) and abs(value) < 1e7:
        return f"{int(value)}"
    return f"{value:.2g}"
