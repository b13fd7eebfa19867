"""Bytes of mesh files: their format, STL with common defects, and the files that they name.

A file's ending states a format; its first bytes show the true format. An OBJ, PLY or GLB file may
name further files: materials and pictures.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from ...base.file_limits import parse_json
from .surface import Refusal

HEAD_BYTES = 512
STL_HEAD, STL_TRIANGLE = 84, 50  # bytes of a binary STL: 80 of text and the count, then each
_OTHER_FORMATS = (  # the first bytes, their file endings, and the words of the error
    (
        rb"version https://git-lfs",
        (),
        "it is a pointer of Git LFS and not the mesh itself; run git lfs pull",
    ),
    (
        rb"<!doctype html|<html",
        (),
        "it is a web page (HTML) and no mesh; the download failed or needs a login, so download "
        "the file again",
    ),
    (rb"ISO-10303-21", (".step", ".stp"), "it is a STEP file; give it the ending .step"),
    (rb"glTF", (".glb",), "it is a GLB file; give it the ending .glb"),
    (rb"ply[\r\n]", (".ply",), "it is a PLY file; give it the ending .ply"),
    (rb"solid\s", (".stl",), "it is an STL file; give it the ending .stl"),
    (rb"PK\x03\x04", (), "it is a ZIP archive or a 3MF file; unpack it, or export STL, OBJ or PLY"),
    (rb"\x1f\x8b", (), "it is compressed (gzip); unpack it"),
    (rb"<\?xml|\{", (), "it is an XML or JSON file; export STL, OBJ, PLY or GLB"),
    (rb"%PDF", (), "it is a PDF document; export STL, OBJ, PLY or GLB"),
)


def refuse_other_format(path: Path, suffix: str) -> None:
    """Refuse a file whose first bytes belong to a different format than its ending states.

    Raises:
        Refusal: the formats differ; the text names the true format and the remedy.
    """
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    for pattern, endings, sentence in _OTHER_FORMATS:
        if suffix not in endings and re.match(pattern, start, re.IGNORECASE):
            if suffix == ".stl" and _is_whole_binary_stl(path, head):
                return  # The 80 bytes of its header are free text.
            raise Refusal(sentence)


def _is_whole_binary_stl(path: Path, head: bytes) -> bool:
    return len(head) >= STL_HEAD and path.stat().st_size == stl_bytes(head)


def stl_bytes(head: bytes) -> int:
    """Return the size of a binary STL in bytes; its header states the number of triangles."""
    return STL_HEAD + STL_TRIANGLE * stl_count(head)


def stl_count(head: bytes) -> int:
    """Return the number of triangles that a binary STL's header states in bytes 80 to 83."""
    return int.from_bytes(head[80:84], "little")


def plain_stl(path: Path) -> tuple[bytes | None, tuple[str, ...]]:
    """Return an STL file's bytes in a form that the reader accepts, and notes on what was removed.

    In a text file, names of solids, which may be in any encoding, are removed, and "end solid"
    becomes "endsolid"; in a binary file, bytes after the last triangle are cut off. None means that
    the file needs no change.

    Raises:
        Refusal: a binary file is shorter than its header states.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
        whole = stl_bytes(head)
        if len(head) >= STL_HEAD and size == whole:
            return None, ()
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
        if text[:5].lower() == b"solid" and b"\0" not in head:
            return _plain_text(head + stream.read()), ()
        if len(head) < STL_HEAD or size < whole:
            raise Refusal(
                f"unreadable as STL: it does not begin with solid as a text does, and as a binary "
                f"file its head counts {stl_count(head)} triangles, which need {whole} bytes, and "
                f"it has {size}; the file may be incomplete, so export it again"
            )
        stream.seek(0)
        note = f"{size - whole} bytes after the last triangle were not read."
        return stream.read(whole), (note,)


def _plain_text(text: bytes) -> bytes:
    text = text.translate(None, bytes(range(128, 256)))
    text = re.sub(rb"\r\n?", b"\n", text)
    text = re.sub(rb"(?im)^[ \t]*end[ \t]*solid\b.*$", b"endsolid", text)
    return re.sub(rb"(?im)^[ \t]*solid\b.*$", b"solid", text)


def files_of_mesh(path: Path) -> tuple[Path, ...]:
    """Return the files that a mesh file uses: materials, and pictures of its colour.

    The files are in the folder of the mesh or below it; names without a file are left out here and
    by the reader. STL and STEP files use no other files.
    """
    names = {".obj": _names_in_obj, ".ply": _names_in_ply, ".glb": _names_in_glb}
    search = names.get(path.suffix.lower())
    if search is None:
        return ()
    files = [file_beside(path, name) for name in search(path)]
    return tuple(dict.fromkeys(file for file in files if file is not None))


def file_beside(path: Path, name: str) -> Path | None:
    r"""Return the file that a mesh file refers to by a name; None if it does not exist.

    Programs on Windows write `maps\red.png`. If a name leads out of the mesh's folder, only its
    last part is used, in that folder.
    """
    folder = path.parent
    for form in (name.strip(), name.strip().replace("\\", "/")):
        for relative in (form, form.lstrip("/"), form.rsplit("/", 1)[-1]):
            file = folder / relative
            inside = file.resolve().is_relative_to(folder.resolve())
            if relative and inside and file.is_file():
                return file
    return None


def _names_in_obj(path: Path) -> Iterator[str]:
    with path.open("rb") as stream:
        libraries = [line for line in stream if line[:7].lower() == b"mtllib "]
    for line in libraries[:1]:  # The reader uses only the first library.
        name = line[7:].decode("utf-8", "replace")
        yield name
        library = file_beside(path, name)
        if library is not None:
            text = library.read_text("utf-8", "replace")
            yield from re.findall(r"(?im)^[ \t]*map_kd[ \t]+(.+?)[ \t]*$", text)


def _names_in_ply(path: Path) -> Iterator[str]:
    with path.open("rb") as stream:
        for line in stream:
            if line.strip() == b"end_header":
                return
            _, key, name = line.decode("utf-8", "replace").partition("TextureFile")
            if key:
                yield name


def _names_in_glb(path: Path) -> Iterator[str]:
    with path.open("rb") as stream:
        head = stream.read(20)
        size = int.from_bytes(head[12:16], "little")
        try:
            record = parse_json(stream.read(min(size, path.stat().st_size)))
            entries = [*record.get("images", ()), *record.get("buffers", ())]
            names = [str(entry.get("uri", "data:")) for entry in entries]
        except (ValueError, TypeError, AttributeError):  # The reader will report a damaged file.
            return
    yield from (name for name in names if not name.startswith("data:"))
