"""Simulates a structured-light camera and makes bin-picking datasets with it."""

__version__ = "0.1.0"
