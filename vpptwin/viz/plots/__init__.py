"""Plots over time, and figures of reports."""
