"""The web page of a dataset: static files that a browser opens from the disk."""

from .build import WIDTH_PX, ReportSummary, write_report

__all__ = ["WIDTH_PX", "ReportSummary", "write_report"]
