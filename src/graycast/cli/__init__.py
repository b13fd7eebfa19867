"""The command `graycast`: files in, files out."""

from .command import main

__all__ = ["main"]
