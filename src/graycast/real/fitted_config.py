"""Replacement of some keys of a configuration file with fitted values."""

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..base.errors import GraycastError
from ..base.settings import check_settings, parse_yaml
from ..cell.config import Config


def refuse_existing(out: Path, base: Path) -> None:
    """Refuse an output path that exists or is not in the folder of the base configuration.

    Raises:
        GraycastError: the file exists, or relative paths would change their meaning.
    """
    refuse_there(out)
    if out.absolute().parent.resolve() != base.absolute().parent.resolve():
        raise GraycastError(
            f"{out}: is not in the folder of {base}, where its relative paths start: write it there"
        )


def refuse_there(*paths: Path) -> None:
    """Raise a GraycastError if one of the files exists."""
    for path in paths:
        if path.exists():
            raise GraycastError(f"{path}: exists already: choose another name, or remove it")


def fitted_text(
    base: str,
    path: Path,
    sections: Mapping[str, Mapping[str, Any] | str],
    comments: Mapping[str, str],
    dropped: Collection[str] = (),
) -> str:
    """Return the text of a configuration with some top-level keys replaced, added or removed.

    All other text stays as the user wrote it, including comments.

    Args:
        base: the text of the configuration.
        path: path of the configuration file, for errors.
        sections: new values by key.
        comments: comments to write above the keys, by key.
        dropped: top-level keys to remove if they are present.

    Raises:
        ConfigError: the result would not be a valid configuration.
    """
    content = parse_yaml(base, path)
    if yaml.compose(base).flow_style:
        base = yaml.safe_dump(dict(content), sort_keys=False)
    lines = base.splitlines()
    spans = _spans(base, lines)
    touched = [*sections, *(key for key in dropped if key in spans)]
    for key in sorted(touched, key=lambda k: -spans.get(k, (math.inf, 0))[0]):
        first, last = spans.get(key, (len(lines), len(lines)))
        new = _block(key, sections[key], comments.get(key, "")) if key in sections else []
        lines[first:last] = new
    text = "\n".join(lines) + "\n"
    check_settings(parse_yaml(text, path), Config, path)
    return text


def _spans(text: str, lines: list[str]) -> dict[str, tuple[int, int]]:
    """Return each top-level key's first line and the line after its value, without comments."""
    starts = [(key.value, key.start_mark.line) for key, _ in yaml.compose(text).value]
    ends = [line for _, line in starts[1:]] + [len(lines)]
    spans = {}
    for (key, first), end in zip(starts, ends, strict=True):
        while end > first + 1 and lines[end - 1].strip()[:1] in ("", "#"):
            end -= 1
        spans[key] = (first, end)
    return spans


def _block(key: str, value: Mapping[str, Any] | str, comment: str) -> list[str]:
    head = [f"# {line}".rstrip() for line in comment.splitlines()]
    flow = False if isinstance(value, str) else None  # With None, YAML puts braces around a string.
    dumped = yaml.safe_dump({key: value}, sort_keys=False, default_flow_style=flow, width=96)
    return head + dumped.rstrip("\n").splitlines()
