"""The process that makes the pictures; its memory and threads are released when it ends."""

import faulthandler
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock, Thread

from ...base.errors import GraycastError, error_line
from ...base.spawn import SPAWN
from .asking import Answer, Ask

STOP_S = 3.0  # time after which a process that has not ended is killed


def _work(connection: Connection, folder: Path, scene_id: int, device: str) -> None:
    """Answer requests until the session ends; if several are waiting, answer only the latest."""
    from .line import Line, Superseded

    faulthandler.enable()  # If native code crashes, this prints the call stack.
    line = Line(
        folder=folder,
        scene_id=scene_id,
        device=device,
        emit=connection.send,
        superseded=connection.poll,
    )
    with suppress(EOFError, BrokenPipeError, KeyboardInterrupt):
        done: Ask | None = None
        while (ask := _last(connection)) is not None:
            try:
                if done is not None and ask == replace(done, number=ask.number, frame=ask.frame):
                    line.look(ask)
                else:
                    done = None
                    line.show(ask)
                    done = ask
            except Superseded:
                continue
            except (GraycastError, ValueError, OSError, MemoryError) as error:
                connection.send(_refusal(ask, error_line(error)))
            except Exception as error:  # The page must also report unexpected errors.
                text = f"{type(error).__name__} {error_line(error)}"
                connection.send(
                    _refusal(ask, f"{text}: this is an error in Graycast or in the machine")
                )
    line.close()


def _last(connection: Connection) -> Ask | None:
    """Return the latest request; None if the session is over."""
    while True:
        ask: Ask | None = connection.recv()
        if ask is None:
            return None
        connection.send(Answer(kind="taken", number=ask.number, header={}, arrays={}))
        if not connection.poll():
            return ask


def _refusal(ask: Ask, text: str) -> Answer:
    return Answer(kind="error", number=ask.number, header={"error": text}, arrays={})


class PictureProcess:
    """The running process, and a thread that forwards its answers."""

    def __init__(
        self,
        *,
        folder: Path,
        scene_id: int,
        device: str,
        on_answer: Callable[[Answer], None],
        on_end: Callable[[str], None],
    ) -> None:
        """Start the process.

        Args:
            on_answer: function that the thread calls with every answer.
            on_end: function that it calls with the cause if the process ends without `stop`.
        """
        self._connection, theirs = SPAWN.Pipe()
        self._process = SPAWN.Process(
            target=_work, args=(theirs, folder, scene_id, device), daemon=True
        )
        self._process.start()
        theirs.close()
        self._on_answer, self._on_end = on_answer, on_end
        self._lock = Lock()  # The lock guards the next three attributes and sending on the pipe.
        self._on_the_way = self._stopping = False
        self._waiting: Ask | None = None
        self._thread = Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        return self._process.pid

    def ask(self, ask: Ask) -> None:
        """Request a picture; if several requests are waiting, only the latest is sent."""
        with self._lock:
            if self._on_the_way:
                self._waiting = ask
            else:
                self._send(ask)

    def _send(self, ask: Ask) -> None:
        self._on_the_way, self._waiting = True, None
        with suppress(BrokenPipeError, OSError):  # `on_end` reports that the process has ended.
            self._connection.send(ask)

    def _taken(self) -> None:
        with self._lock:
            self._on_the_way = False
            if self._waiting is not None:
                self._send(self._waiting)

    def stop(self) -> None:
        """End the process; this releases all its resources."""
        with self._lock, suppress(BrokenPipeError, OSError):
            self._stopping, self._waiting = True, None
            self._connection.send(None)
        self._thread.join(STOP_S)
        if self._thread.is_alive():
            self._process.kill()
            self._thread.join()
        self._connection.close()
        self._process.close()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                answer: Answer = self._connection.recv()
                if answer.kind == "taken":
                    self._taken()
                else:
                    self._on_answer(answer)
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        with self._lock:
            stopping = self._stopping
        if not stopping:
            code = self._process.exitcode or 0
            self._on_end(f"exit code {code}" if code >= 0 else signal.Signals(-code).name)
