"""A live cell in the browser: the effect of each setting is visible while it is changed.

`Session` holds the settings. A separate process, which ends with the page, holds the results of all
stages (`line.py`). `serve` provides the page, which only this machine can open.
"""

from .server import Server, serve
from .session import Message, Session

__all__ = ["Message", "Server", "Session", "serve"]
