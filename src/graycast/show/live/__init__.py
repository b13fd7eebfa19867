"""A cell in the browser, alive: what each setting does is seen while it is set.

`Session` keeps what is set; a process of its own, which ends with the page, keeps the whole line
open (`line.py`); `serve` shows both on this machine alone.
"""

from .server import Server, serve
from .session import Message, Session

__all__ = ["Message", "Server", "Session", "serve"]
