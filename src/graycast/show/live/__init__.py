"""A live cell in the browser, which shows the effect of each setting while it is changed.

`Session` holds the settings. A separate process holds the results of all stages (`line.py`); it
ends when the page is closed. `serve` provides the page, which only this machine can open.
"""

from .server import Server, serve
from .session import Message, Session

__all__ = ["Message", "Server", "Session", "serve"]
