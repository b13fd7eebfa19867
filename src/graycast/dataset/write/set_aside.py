"""`set_aside.json`: the scenes of a folder that were given up, and the reasons.

A scene stays in the file until a run makes it or tries it again, so a run with fewer scenes loses
no entry.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from ...base.errors import DatasetError, GraycastError
from ...base.folder import write_whole
from ...base.public_value import public_value
from ..files.json_text import json_bytes
from ..files.safe_reading import Unreadable, read_json

SETASIDE = "set_aside.json"


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SetAside:
    """A scene that failed in all tries: the reason, and a traceback if the error was unexpected."""

    scene_id: int
    tries: int
    reason: str
    traceback: str = ""


@final
@dataclass(frozen=True, slots=True)
class SetAsideFile:
    """The `set_aside.json` of a folder, with an entry for each scene by its name."""

    folder: Path

    @property
    def path(self) -> Path:
        return self.folder / SETASIDE

    def forget(self, names: Iterable[str]) -> None:
        """Remove scenes that were made, or that this run tries again.

        Raises:
            GraycastError: the file is damaged or cannot be written.
        """
        entries = self._read()
        gone = entries.keys() & set(names)
        self._write({name: entry for name, entry in entries.items() if name not in gone})

    def add(self, name: str, scene: SetAside) -> None:
        """Record a scene that was given up.

        Raises:
            GraycastError: the file is damaged or cannot be written.
        """
        entry = {
            "reason": scene.reason,
            "traceback": scene.traceback.splitlines(),
            "tries": scene.tries,
        }
        self._write(self._read() | {name: entry})

    def _read(self) -> dict[str, Any]:
        if not self.path.exists():
            return {}
        try:
            return read_json(self.path, dict[str, Any])
        except Unreadable as error:
            raise DatasetError(f"{self.path}: cannot be read ({error}): remove it") from error

    def _write(self, entries: dict[str, Any]) -> None:
        if entries:
            write_whole(self.path, json_bytes(entries))
            return
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise GraycastError(
                f"{self.path}: cannot be removed ({error.strerror}): make the folder writable"
            ) from error
