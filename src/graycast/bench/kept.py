"""The file of a long study: it is written after each row, and a later run continues from it."""

import json
from collections.abc import Sequence
from pathlib import Path

from ..errors import GraycastError
from ..file_limits import parse_json
from ..folder import write_whole
from .figures import Figures


def kept_rows(file: Path, study: str, settings: Figures) -> list[Figures]:
    """The rows, finished or not, that an earlier run has left; none where there is no file.

    Args:
        file: the study's JSON file.
        study: its name, under which the rows stand.
        settings: all that decides what is in a row; the file has to state the same.

    Raises:
        GraycastError: the file is of something else, or of other settings.
    """
    if not file.exists():
        return []
    try:
        before = parse_json(file.read_bytes())
    except (ValueError, OSError) as error:
        raise GraycastError(f"{file}: cannot be read as JSON ({error}): {_OTHER}") from None
    rows = before.get(study) if isinstance(before, dict) else None
    if not isinstance(rows, list) or before.get("benchmark") != study:
        raise GraycastError(f"{file}: holds no figures of this study ({study}): {_OTHER}")
    for name, value in settings.items():
        if before.get(name) != value:
            raise GraycastError(
                f"{file}: was made with {name} {_short(before.get(name))}, and this command has "
                f"{_short(value)}: {_OTHER}, or give the same options to continue"
            )
    return rows


def write_figures(file: Path, figures: Figures) -> None:
    """The figures as JSON, whole or not at all."""
    write_whole(file, (json.dumps(figures, indent=2) + "\n").encode())


_OTHER = "choose another file, or remove this one"


def _short(value: object) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(map(str, value))
    return str(value)
