"""YAML files that hold frozen pydantic models: read, checked, and refused with one clear line."""

import difflib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from .errors import ConfigError

Vector = tuple[float, float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
Level = Annotated[float, Field(ge=0)]


def _ordered(span: tuple[Any, Any]) -> tuple[Any, Any]:
    if span[0] > span[1]:
        raise ValueError("give [lowest, highest], the lowest first")
    return span


Number = TypeVar("Number")
SpanOf = Annotated[tuple[Number, Number], AfterValidator(_ordered)]  # [lowest, highest]
Span = SpanOf[float]
PositiveSpan = SpanOf[Positive]
ShareSpan = SpanOf[Share]


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
    first = next((p for p in problems if p["type"] in _UNKNOWN), problems[0])
    key = ".".join(_place(model, first["loc"])[0]) or "the file"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] in _UNKNOWN:
        known = _place(model, first["loc"][:-1])[1]
        near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"
        return f"unknown key {key}: {hint}{more}"
    if first["type"] == "missing":
        return f"{key} is missing: add it{more}"
    message = first["msg"].removeprefix("Value error, ")
    if isinstance(first["input"], Mapping):
        return f"{key}: {message}{more}"
    return f"{key} is {first['input']!r}: {message[0].lower()}{message[1:]}{more}"


# What pydantic calls a key that a section, or a dataclass in its place, does not know.
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


@cache
def _schema(model: type[Settings]) -> Mapping[str, Any]:
    return model.model_json_schema()


def _place(model: type[Settings], location: tuple[int | str, ...]) -> tuple[list[str], list[str]]:
    """Where a problem is: the keys that lead there, and the keys known there, by the JSON Schema.

    Where a key `kind` chooses between sections, pydantic puts the choice into its locations; what
    a user reads has only the keys of his file.
    """
    schema = _schema(model)
    path, options = [], [schema]
    for key in location:
        chosen = [option for option in options if _kind(option) == key]
        if chosen:
            options = chosen
            continue
        path.append(str(key))
        node = options[0] if options else {}
        inner = node.get("items") if isinstance(key, int) else node.get("properties", {}).get(key)
        options = _sections(inner or {}, schema)
    return path, list(options[0].get("properties", {})) if options else []


def _sections(node: Mapping[str, Any], schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What a value may be, references followed, sections first."""
    if "$ref" in node:
        return [schema["$defs"][node["$ref"].rsplit("/", 1)[1]]]
    choices = node.get("anyOf", node.get("oneOf"))
    if choices is None:
        return [node]
    found = [section for option in choices for section in _sections(option, schema)]
    return sorted(found, key=lambda section: "properties" not in section)


def _kind(section: Mapping[str, Any]) -> str | None:
    return section.get("properties", {}).get("kind", {}).get("const")
