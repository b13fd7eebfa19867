"""A session: the settings with their history, the files, and the process that makes pictures."""

import hashlib
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import RLock
from typing import Any

from ...base.errors import ConfigError, GraycastError
from ...base.folder import write_whole
from ...base.settings import check_settings, parse_yaml, read_text
from ...cell.config import Config, resolve_scanner
from .asking import Answer, Ask
from .controls import described_controls
from .document import Document, RigChange, changed, checked, document_text, files_of
from .picture_process import PictureProcess

MOST_UNDO = 500
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,80}\.ya?ml")


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A message to a page. Pictures are not part of it; pages fetch them by their number."""

    kind: str
    content: Mapping[str, Any]


class Session:
    """The state behind the page. Its methods may be called from any thread."""

    def __init__(
        self,
        path: Path,
        *,
        scene_id: int = 0,
        device: str = "auto",
        on_message: Callable[[Message], None] = lambda message: None,
    ) -> None:
        """Read and check a configuration; pictures are made after `open`.

        Args:
            path: the file of the configuration, which is never written.
            on_message: function that receives every message for a page.

        Raises:
            ConfigError: see `load_config`.
        """
        self._path, self._scene_id, self._device = path, scene_id, device
        self._on_message = on_message
        document = Document(content=dict(parse_yaml(read_text(path), path)))
        checked(document, path)
        self._states, self._at, self._draft = [document], 0, False
        self._frame = 2
        self._number = self._version = 0
        self._requests: dict[int, Document] = {}
        self._request_s: dict[int, float] = {}
        self._latest: dict[str, tuple[int, Answer]] = {}  # by kind: version and answer
        self._refusal: Message | None = None
        self._own: set[Path] = set()  # files that this session has written
        self._lock = RLock()
        self._maker: PictureProcess | None = None
        self._has_finished = False  # whether the running process has made an exact result
        self._folder = Path(tempfile.mkdtemp(prefix="graycast-live-"))

    # --- opening and closing ------------------------------------------------------------------

    @property
    def pid(self) -> int | None:
        """Id of the process that makes the pictures; None if there is no process."""
        with self._lock:
            return None if self._maker is None else self._maker.pid

    @property
    def number(self) -> int:
        """Number of the latest request."""
        with self._lock:
            return self._number

    def open(self) -> None:
        """Start to make pictures, unless the process runs already."""
        with self._lock:
            if self._maker is None:
                self._has_finished = False
                self._maker = PictureProcess(
                    folder=self._path.parent,
                    scene_id=self._scene_id,
                    device=self._device,
                    on_answer=self._answered,
                    on_end=self._ended,
                )
                self._show()

    def pause(self) -> None:
        """Release all memory and threads; keep the settings and their history."""
        with self._lock:
            maker, self._maker = self._maker, None
            self._latest.clear()
        if maker is not None:
            maker.stop()

    def close(self) -> None:
        self.pause()
        shutil.rmtree(self._folder, ignore_errors=True)

    # --- actions of a user --------------------------------------------------------------------

    def set(self, key: str, value: Any, *, draft: bool = False) -> None:
        """Set one value, as in `document.changed`; consecutive drafts are a single undo step.

        Raises:
            ConfigError: the configuration would be invalid; the settings are not changed.
        """
        with self._lock:
            self._take(changed(self._now, key, value), draft=draft)

    def rewrite(self, text: str) -> None:
        """Replace the text of the configuration; keep the separate adjustments.

        Raises:
            ConfigError: the configuration would be invalid; the settings are not changed.
        """
        with self._lock:
            content = dict(parse_yaml(text, self._path))
            self._take(replace(self._now, content=content), draft=False)

    def undo(self, steps: int = 1) -> None:
        """Undo some steps, or redo them if the number is negative; stop at the history's ends."""
        with self._lock:
            self._draft = False
            self._at = min(max(self._at - steps, 0), len(self._states) - 1)
            self._show()

    def return_to(self, number: int) -> None:
        """Restore the settings of the picture with this number."""
        with self._lock:
            if number not in self._requests:
                raise ConfigError(f"picture {number} is no longer stored: set its values by hand")
            self._take(self._requests[number], draft=False)

    def look(self, frame: int) -> None:
        """Show another captured frame."""
        with self._lock:
            self._frame = frame
            self._show()

    def save(self, name: str) -> Path:
        """Write the settings to the configuration's folder, for all commands of Graycast.

        Returns:
            The path of the configuration. A changed rig gets its own file in the same folder.

        Raises:
            GraycastError: the name is invalid, a file that this session has not written has this
                name, or the file cannot be written.
        """
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f"{name!r} is not a valid file name: give letters, digits, dots and dashes, with "
                ".yaml at the end"
            )
        with self._lock:
            path = self._path.parent / name
            rig_path = path.with_name(f"{path.stem}_rig.yaml")
            content, rig_text = files_of(self._now, self._path, rig_name=rig_path.name)
            files = {path: document_text(content)}
            if rig_text is not None:
                files[rig_path] = rig_text
            for file in files:
                if file.exists() and file not in self._own:
                    raise GraycastError(f"{file} exists already: give another name")
            for file, text in files.items():
                write_whole(file, text.encode())
                self._own.add(file)
        return path

    # --- data for a page ----------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Return the settings for a page: text, adjustments, and whether undo is possible."""
        with self._lock:
            now = self._now
            config = checked(now, self._path)
            controls = self._controls(config)
            return {
                "path": str(self._path),
                "text": document_text(now.content),
                "controls": controls["controls"],
                "values": {
                    **controls["values"],
                    "ambient": now.ambient,
                    **{
                        f"rig.{name}": getattr(now.rig, name)
                        for name in RigChange.__dataclass_fields__
                    },
                    "rig": config.rig,
                    "resolution": config.resolution,
                },
                "said": _keys_of(now.content) + _turned(now),
                "undo": self._at,
                "redo": len(self._states) - 1 - self._at,
                "number": self._number,
            }

    def _controls(self, config: Config) -> dict[str, Any]:
        """Return the controls; none if the rig is unreadable, so users can correct the text."""
        try:
            return described_controls(config, resolve_scanner(config, self._path.parent))
        except (GraycastError, ValueError, OSError):
            return {"controls": [], "values": {}}

    @contextmanager
    def standing_still(self) -> Iterator[None]:
        """Block settings and answers, so that a new page misses no message."""
        with self._lock:
            yield

    def newer(self, version: int) -> list[tuple[int, Answer]]:
        """Return the latest answer of each kind and its version, if it is newer than `version`."""
        with self._lock:
            return [latest for latest in self._latest.values() if latest[0] > version]

    @property
    def refusal(self) -> Message | None:
        """Message that explains why the settings give no picture; None if they were not refused."""
        with self._lock:
            return self._refusal

    # --- private ------------------------------------------------------------------------------

    @property
    def _now(self) -> Document:
        return self._states[self._at]

    def _take(self, document: Document, *, draft: bool) -> None:
        config = self._config(document)  # This refuses invalid documents before they are stored.
        resolve_scanner(config, self._path.parent)
        if self._draft and self._at > 0:
            self._states[self._at] = document
            del self._states[self._at + 1 :]
        else:
            del self._states[self._at + 1 :]
            self._states.append(document)
            del self._states[: max(len(self._states) - MOST_UNDO, 0)]
            self._at = len(self._states) - 1
        self._draft = draft
        self._show()

    def _show(self) -> None:
        """Send the settings to the page and request a picture."""
        self._number += 1
        self._refusal = None
        self._request_s[self._number] = time.perf_counter()
        self._requests[self._number] = self._now
        for old in [n for n in self._requests if n <= self._number - MOST_UNDO]:
            del self._requests[old], self._request_s[old]
        self._on_message(Message(kind="state", content=self.state()))
        if self._maker is not None:
            now, unturned = self._now, replace(self._now, ambient=1.0)
            unturned = replace(unturned, rig=replace(now.rig, power=1.0))
            self._maker.ask(
                Ask(
                    number=self._number,
                    config=self._config(now),
                    unturned=self._config(unturned),
                    ambient=now.ambient,
                    power=now.rig.power,
                    frame=self._frame,
                )
            )

    def _config(self, document: Document) -> Config:
        """Return the document's configuration; its rig file is in the session's own folder."""
        content, rig_text = files_of(document, self._path, rig_name="rig.yaml")
        if rig_text is not None:
            digest = hashlib.sha256(rig_text.encode()).hexdigest()[:16]
            file = self._folder / f"rig-{digest}.yaml"
            if not file.exists():
                write_whole(file, rig_text.encode())
            content = {**content, "rig": str(file)}
        return check_settings(content, Config, self._path)

    def _answered(self, answer: Answer) -> None:
        with self._lock:
            request_s = self._request_s.get(answer.number)
            waited_ms = None if request_s is None else 1e3 * (time.perf_counter() - request_s)
            content = dict(answer.header)
            self._has_finished |= content.get("exact", False)
            if answer.arrays:
                self._version += 1
                self._latest[answer.kind] = self._version, answer
                keys = ("number", "kind", "first", "samples", "of", "exact")
                content = {name: content[name] for name in keys if name in content}
                content |= {"version": self._version, "waited_ms": waited_ms}
            if answer.kind == "error":
                content["number"] = answer.number
            message = Message(kind=answer.kind, content=content)
            if answer.kind == "error" and answer.number == self._number:
                self._refusal = message
        self._on_message(message)

    def _ended(self, by: str) -> None:
        """Report that the process ended without `stop`, and start a new one where that can help.

        If the old process never finished a picture, a new one would end likewise: none is started.
        """
        with self._lock:
            if self._maker is None:  # `pause` was called first.
                return
            self._maker = None
            text = f"the process that makes the pictures was ended by {by}"
            if self._has_finished:
                self.open()
                text += ": it was started again, and nothing that you set is lost"
                message = Message(kind="error", content={"error": text})
            else:
                text += " before it finished a picture: undo the last change, then reload the page"
                message = Message(kind="error", content={"error": text, "number": self._number})
                self._refusal = message
        self._on_message(message)


def _turned(document: Document) -> list[str]:
    """Return the keys of the separate adjustments that are not neutral."""
    as_it_is = asdict(RigChange())
    names = [
        f"rig.{name}" for name, value in asdict(document.rig).items() if value != as_it_is[name]
    ]
    return names + (["ambient"] if document.ambient != 1 else [])


def _keys_of(content: Mapping[str, Any], before: str = "") -> list[str]:
    """Return every key of the configuration's text in dotted form."""
    keys = []
    for name, value in content.items():
        key = f"{before}{name}"
        keys.append(key)
        if isinstance(value, Mapping):
            keys += _keys_of(value, f"{key}.")
    return keys
