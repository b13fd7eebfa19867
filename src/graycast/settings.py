"""YAML files that hold frozen pydantic models: read, checked, and refused with one clear line."""

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from .errors import ConfigError


class Settings(BaseModel):
    """What a user writes: unknown keys, NaN and infinity are refused, and nothing changes later."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=Settings)


def read_settings(path: Path, model: type[Model]) -> Model:
    """Read and check a file.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown, missing or wrong key.
    """
    return check_settings(parse_yaml(read_text(path), path), model, path)


def check_settings(content: Mapping[str, Any], model: type[Model], path: Path) -> Model:
    """Check what a file said."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {_first_problem(error, model)}") from error


def read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file: check the path") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}): give a file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not a text file: give YAML") from error


def parse_yaml(text: str, path: Path) -> Mapping[str, Any]:
    """A YAML mapping; what is none is refused by line."""
    try:
        content = yaml.load(text, Loader=_OneOfEachKey)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        why = getattr(error, "problem", None) or "bad characters"
        raise ConfigError(f"{path}: is not YAML{line} ({why}): mend or remove that line") from error
    except (ValueError, RecursionError) as error:  # an impossible date, brackets without end
        raise ConfigError(f"{path}: is not YAML ({error}): mend or remove that line") from error
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: holds no keys: give a mapping such as 'name: value' lines")
    return content


class _OneOfEachKey(yaml.SafeLoader):
    """YAML that refuses a key written twice, where PyYAML would take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                why = f"{key.value} is given twice"
                raise yaml.constructor.ConstructorError(None, None, why, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _first_problem(error: ValidationError, model: type[Settings]) -> str:
    """The first of pydantic's complaints in one line: key, value and what is allowed."""
    problems = error.errors(include_url=False)
    # pydantic counts only the sound items of a list: what is wrong inside makes it too short, too.
    inside = {problem["loc"][:-depth] for problem in problems for depth in range(1, 8)}
    problems = [p for p in problems if p["type"] != "too_short" or p["loc"] not in inside]
    # A misspelt key goes first, because it explains the one that is missing.
    first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    key = ".".join(str(part) for part in first["loc"]) or "the file"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] == "extra_forbidden":
        known = _known_keys(model, first["loc"][:-1])
        near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"
        return f"unknown key {key}: {hint}{more}"
    if first["type"] == "missing":
        return f"{key} is missing: add it{more}"
    message = first["msg"].removeprefix("Value error, ")
    if isinstance(first["input"], Mapping):
        return f"{key}: {message}{more}"
    return f"{key} is {first['input']!r}: {message[0].lower()}{message[1:]}{more}"


def _known_keys(model: type[Settings], location: tuple[int | str, ...]) -> list[str]:
    """Names of the keys that are known at a place, found by following the JSON Schema."""
    schema = model.model_json_schema()
    node: Mapping[str, Any] = schema
    for key in location:
        node = node.get("items", {}) if isinstance(key, int) else node["properties"][str(key)]
        node = next((option for option in node.get("anyOf", ()) if "$ref" in option), node)
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[1]]
    return list(node.get("properties", {}))
