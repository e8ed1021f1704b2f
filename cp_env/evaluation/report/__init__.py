"""Reports of an evaluation: tables, pages, plots, pictures."""

from __future__ import annotations

from cp_env.evaluation.report.benchmark import about, markdown, screen, write_report

__all__ = ["about", "markdown", "screen", "write_report"]
