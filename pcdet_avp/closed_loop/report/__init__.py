"""Crash tables, plots and the report of a sweep."""
