"""The version of Graycast, which its output files state."""

__version__ = "0.1.0"
