"""Build a page from pieces, one per scene or bin; only new or changed pieces are written."""

import hashlib
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from string import Template
from typing import Protocol, runtime_checkable

from ....base.errors import GraycastError
from ....base.folder import beside, remove_left, write_whole
from ....base.progress import UNWATCHED, ProgressMeter
from ....base.spawn import in_order

PIECES = "scenes"  # folder from which the scripts of the page read the pieces
_STAMP = "stamp"
_MARK = "graycast-report"


@runtime_checkable
class Piece(Protocol):
    """A part of the page with its own files, which a worker process makes."""

    @property
    def key(self) -> str: ...

    def stamp(self) -> str:
        """Return a string that changes when the files must be made again."""
        ...

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Yield the files as (name, content)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSummary:
    """Result of a build: the `page` to open, and the numbers of pieces."""

    page: Path
    built: int
    current: int
    removed: int


def stamp_of(text: str, folder: Path, names: Iterable[str]) -> str:
    """Return a digest of a string and of the files' state; missing files are skipped."""
    digest = hashlib.sha256(text.encode())
    for name in names:
        path = folder / name
        if path.exists():
            state = path.stat()
            digest.update(f"{name} {state.st_size} {state.st_mtime_ns}".encode())
    return digest.hexdigest()


@contextmanager
def writing_page(out: Path, source: Path) -> Iterator[None]:
    """Open the page's folder, and convert disk errors inside the block to `GraycastError`.

    Args:
        out: a folder that is new, is empty, or holds an earlier report.
        source: the folder that the page describes.

    Raises:
        GraycastError: `out` holds something else, or cannot be written.
    """
    _open_folder(out, source)
    try:
        (out / PIECES).mkdir(exist_ok=True)
        yield
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{out}: cannot be written ({why}): free disk space or choose another folder, and run "
            "the same command again; the finished scenes are kept"
        ) from error


def write_pieces(
    out: Path,
    pieces: Sequence[Piece],
    *,
    workers: int,
    what: str,
    progress: ProgressMeter = UNWATCHED,
) -> ReportSummary:
    """Make the new and changed pieces, and remove pieces that no longer exist.

    Args:
        out: the page's folder, opened with `writing_page`.
        workers: number of processes.
        what: name of the pieces, with which `progress` counts them.
    """
    folder = out / PIECES
    remove_left(folder)
    todo = [piece for piece in pieces if not _is_current(folder, piece)]
    current = len(pieces) - len(todo)
    progress.count(what, current, len(pieces))
    keys = in_order(partial(_make, folder=folder), todo, workers=workers)
    for done, _ in enumerate(keys, start=current + 1):
        progress.count(what, done, len(pieces))
    gone = {entry.name for entry in folder.iterdir()} - {piece.key for piece in pieces}
    for key in gone:
        shutil.rmtree(folder / key)
    return ReportSummary(
        page=out / "index.html", built=len(todo), current=current, removed=len(gone)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Web:
    """The files that a browser loads, and the values of the page template.

    `styles` and `scripts` are files, in loading order, of the folder `web` in `package` or in this
    package. Every page also needs style.css, core.js and index.js, which the template loads first,
    and app.js, which it loads last.
    """

    package: str
    title: str
    home: str  # text of the link to the overview
    styles: tuple[str, ...] = ()
    scripts: tuple[str, ...]


def write_web(out: Path, web: Web) -> None:
    """Write the files that a browser loads, except index.js, which contains the page's data."""
    folders = [resources.files(name).joinpath("web") for name in (web.package, __package__)]
    for name in ("style.css", "core.js", "app.js", *web.styles, *web.scripts):
        file = next(file for folder in folders if (file := folder.joinpath(name)).is_file())
        write_whole(out / name, file.read_bytes())
    template = Template(folders[-1].joinpath("index.html").read_text(encoding="utf-8"))
    page = template.substitute(
        title=web.title,
        home=web.home,
        styles="".join(f'    <link rel="stylesheet" href="{name}" />\n' for name in web.styles),
        scripts="".join(f'    <script src="{name}"></script>\n' for name in web.scripts),
    )
    write_whole(out / "index.html", page.encode())


def _open_folder(out: Path, source: Path) -> None:
    if out.resolve() == source.resolve():
        raise GraycastError(f"{out} is the dataset itself: give another folder for the page")
    try:
        out.mkdir(parents=True, exist_ok=True)
        entries = [entry.name for entry in out.iterdir()]
        if entries and _MARK not in entries:
            raise GraycastError(
                f"{out} is not empty and holds no report (it has {min(entries)}): choose another "
                "folder"
            )
        (out / _MARK).write_text("made by graycast report; safe to remove with its folder\n")
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(f"{out}: cannot be written ({why}): choose another folder") from error


def _is_current(folder: Path, piece: Piece) -> bool:
    stamp = folder / piece.key / _STAMP
    return stamp.exists() and stamp.read_text() == piece.stamp()


def _make(piece: Piece, *, folder: Path) -> str:
    stamp = piece.stamp()  # If the piece changes while it is read, it is made again next time.
    with beside(folder / piece.key) as aside:
        aside.mkdir()
        for name, data in piece.files():
            (aside / name).write_bytes(data)
        (aside / _STAMP).write_text(stamp)
        shutil.rmtree(folder / piece.key, ignore_errors=True)
    return piece.key
