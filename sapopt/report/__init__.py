"""One HTML page about a problem and its results, to look at and to send: `report`."""

from sapopt.report.page import report

__all__ = ["report"]
