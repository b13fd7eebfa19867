"""The version of Graycast, which the files that it writes state."""

__version__ = "0.1.0"
