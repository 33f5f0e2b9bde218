"""Proof of a lake from its own tables, without a CAD kernel."""

from __future__ import annotations

from breplake.queries.check.report import Offender, Report, RuleResult
from breplake.queries.check.run import check_lake

__all__ = ["Offender", "Report", "RuleResult", "check_lake"]
