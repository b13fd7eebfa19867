"""Read YAML files as frozen pydantic models, with errors of one clear line.

The bounds of a number are stated only once, by pydantic's `Field` in the annotation of the value's
own dataclass. The dataclass refuses values that its annotations do not allow (`check_fields`).
`sections` makes sections of files from dataclasses.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic.fields import FieldInfo

from .argument_check import fits, nearest, value_text, words
from .errors import ArgumentError, ConfigError
from .public_value import one_line
from .section_help import SectionType

Vector = tuple[float, float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
Level = Annotated[float, Field(ge=0)]
Finite = Annotated[float, Field(allow_inf_nan=False)]  # In files every number is finite.


def _ordered(span: tuple[Any, Any]) -> tuple[Any, Any]:
    if span[0] > span[1]:
        raise ValueError("give two numbers [lowest, highest] in this order")
    return span


Number = TypeVar("Number")
SpanOf = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
Span = SpanOf[float]
PositiveSpan = SpanOf[Positive]
ShareSpan = SpanOf[Share]


class Settings(BaseModel, metaclass=SectionType):
    """Base of all models of user files: frozen; refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, **settings: Any) -> None:
        """Make a section from keywords.

        Raises:
            ArgumentError: a keyword is unknown, missing or wrong.
        """
        try:
            super().__init__(**settings)
        except ValidationError as error:
            kind = type(self)
            problem = _first_problem(error, kind, whole="the arguments")
            raise ArgumentError(f"{kind.__name__}: {problem}") from None

    # Pydantic otherwise calls this method for each section that it reads from a file.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            super().__setattr__(name, value)
        except (ValidationError, ValueError):
            kind = type(self).__name__
            raise ArgumentError(f"{kind}: {name} cannot be set later: make a new {kind}") from None

    __repr__ = __str__ = one_line

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: Any, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Describe a key that contains a section by the first paragraph of that section."""
        schema = handler(core)
        for node in handler.resolve_ref_schema(schema).get("properties", {}).values():
            for option in (node, *node.get("anyOf", ())):
                if "$ref" in option and "description" not in node:
                    about = handler.resolve_ref_schema(option)["description"]
                    node["description"] = " ".join(about.split("\n\n")[0].split())
        return schema


# --- dataclasses --------------------------------------------------------------------------------


def check_fields(value: object) -> None:
    """Refuse values that a dataclass's annotations do not allow; its `__post_init__` calls this.

    A field's default is always allowed, even infinity, which then means that there is no limit.

    Raises:
        ValueError: a value is refused; the text names the field, its value and allowed values.
    """
    kind: Any = type(value)  # `Any`, because mypy doubts that a type is hashable
    for name, (allowed, default, about) in _limits(kind).items():
        item = getattr(value, name)
        # Unpickled infinity is a different object from the default.
        if item is default or default == math.inf == item:
            continue
        if not isinstance(allowed, TypeAdapter):
            if not fits(item, allowed):
                raise ValueError(f"{name} is {value_text(item)}: give {words(allowed)}")
            continue
        try:
            allowed.validate_python(item)
        except ValidationError as error:
            why = _reason(error.errors(include_url=False)[0]["msg"])
            raise ValueError(f"{name} is {item!r}: {why}{about}") from None


def declared_fields(dataclass: Any) -> list[tuple[str, Any, FieldInfo, Any]]:
    """Return the name, bare annotation, `Field` and default of each field of a dataclass."""
    hints = get_type_hints(dataclass, include_extras=True)
    rows = []
    for field in fields(dataclass):
        hint = hints[field.name]
        info = FieldInfo.from_annotation(hint)
        if get_origin(hint) is Annotated:
            hint = info.annotation
            if info.metadata:
                hint = Annotated[(hint, *info.metadata)]
        default = field.default
        if field.default_factory is not MISSING:
            default = field.default_factory()
        rows.append((field.name, hint, info, default))
    return rows


@cache
def _limits(dataclass: type) -> dict[str, tuple[Any, Any, str]]:
    """Return for each field its annotation, default and meaning.

    An annotation with more than a type, such as bounds, is returned as a `TypeAdapter`.
    """
    config = ConfigDict(strict=True, allow_inf_nan=False)
    limits = {}
    for name, hint, info, default in declared_fields(dataclass):
        meaning = f" ({info.description.rstrip('.')})" if info.description else ""
        allowed = TypeAdapter(hint, config=config) if _says_more(hint) else hint
        limits[name] = (allowed, default, meaning)
    return limits


def _says_more(hint: Any) -> bool:
    return get_origin(hint) is Annotated or any(_says_more(inner) for inner in get_args(hint))


def _reason(message: str) -> str:
    """Return pydantic's message as the second half of a sentence."""
    message = message.removeprefix("Value error, ").replace("Input should", "it should", 1)
    return f"{message[0].lower()}{message[1:]}"


# --- reading -----------------------------------------------------------------------------------

Model = TypeVar("Model", bound=Settings)


def read_settings(path: Path, model: type[Model]) -> Model:
    """Read a YAML file and check it against a model.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown, missing or wrong key.
    """
    return check_settings(parse_yaml(read_text(path), path), model, path)


def check_settings(content: Mapping[str, Any], model: type[Model], path: Path) -> Model:
    """Check the content of a file against a model; raise a ConfigError if it does not fit."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {_first_problem(error, model, whole='the file')}") from error


def read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file: check the path") from error
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror}): give a readable file"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not a text file: give a YAML file") from error


def parse_yaml(text: str, path: Path) -> Mapping[Any, Any]:
    """Return the mapping in a YAML text, whose keys may be numbers; refuse any other text."""
    import yaml  # Programs that only read a dataset need no PyYAML.

    from .yaml_loader import OneOfEachKey

    try:
        content = yaml.load(text, Loader=OneOfEachKey)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        why = getattr(error, "problem", None) or "bad characters"
        raise ConfigError(
            f"{path}: is not YAML{line} ({why}): correct or remove that line"
        ) from error
    except (
        ValueError,
        RecursionError,
    ) as error:  # For example an impossible date, or too deeply nested brackets.
        raise ConfigError(f"{path}: is not YAML ({error}): correct or remove that line") from error
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: holds no keys: give lines such as 'name: value'")
    return content


def _first_problem(error: ValidationError, model: type[Settings], *, whole: str) -> str:
    """Return the first problem that pydantic reports, in one line: key, value and allowed values.

    Args:
        whole: a name for all keys together, for a problem that is not about a single key.
    """
    problems = error.errors(include_url=False)
    # pydantic counts only valid items, so a list with an invalid item may also be "too short".
    inside = {problem["loc"][:-depth] for problem in problems for depth in range(1, 8)}
    problems = [p for p in problems if p["type"] != "too_short" or p["loc"] not in inside]
    # A misspelt key goes first, because it explains the missing key.
    first = next((p for p in problems if p["type"] in _UNKNOWN), problems[0])
    key = ".".join(_place(model, first["loc"])[0]) or whole
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] in _UNKNOWN:
        return f"unknown key {key}: {_hint(model, first['loc'])}{more}"
    if first["type"] == "missing":
        return f"{key} is missing: add it{more}"
    if kind := _KINDS.get(first["type"]):
        value = "a mapping" if isinstance(first["input"], Mapping) else repr(first["input"])
        return f"{key} is {value}: it should be {kind}{more}"
    if isinstance(first["input"], Mapping):
        return f"{key}: {first['msg'].removeprefix('Value error, ')}{more}"
    return f"{key} is {first['input']!r}: {_reason(first['msg'])}{more}"


def _hint(model: type[Settings], location: tuple[int | str, ...]) -> str:
    """Suggest the section to which an unknown key belongs, or else a similar known key."""
    *above, key = location
    known = _place(model, tuple(above))[1]
    for section in _place(model, tuple(above[:-1]))[1] if above else ():
        if key in _place(model, (*above[:-1], section))[1]:
            return f"it belongs to the section {section}, so move it there"
    return nearest(str(key), known)


# Pydantic describes these types in Python's terms, which users of YAML files need not know.
_KINDS = {
    "tuple_type": "a list",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "path_type": "a path",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "model_type": "a section with keys",
    "model_attributes_type": "a section with keys",
    "dataclass_type": "a section with keys",
}
# Pydantic gives these types to a key that a section, or a dataclass in its place, does not know.
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


@cache
def _schema(model: type[Settings]) -> Mapping[str, Any]:
    return model.model_json_schema()


def setting_description(model: type[Settings], key: str) -> str:
    """Return the description of a key such as `decode.doubt`; empty if the model has no such key.

    A number in the key is the index of an entry in a list.
    """
    schema, text = _schema(model), ""
    options = [schema]
    for word in key.split("."):
        if word.isdigit():
            nodes = [inner for option in options if (inner := option.get("items"))]
        else:
            known = (option.get("properties", {}) for option in options)
            nodes = [keys[word] for keys in known if word in keys]
            text = next((node["description"] for node in nodes if "description" in node), "")
        options = [section for node in nodes for section in _sections(node, schema)]
    return text


def allowed_values(node: Mapping[str, Any]) -> str:
    """Return the values that a JSON Schema allows in words, such as `number > 0, ≤ 1`."""
    if "enum" in node:
        return ", ".join(map(str, node["enum"]))
    if "items" in node:
        return f"list of {allowed_values(node['items'])}"
    types = {"integer": "whole number", "boolean": "true or false", "string": "text"}
    kind = "path" if node.get("format") == "path" else types.get(node["type"], node["type"])
    if "minimum" in node and "maximum" in node:
        return f"{kind} from {node['minimum']:g} to {node['maximum']:g}"
    limits = ("minimum ≥", "exclusiveMinimum >", "maximum ≤", "exclusiveMaximum <")
    pairs = [limit.split() for limit in limits]
    signs = ", ".join(f"{sign} {node[limit]:g}" for limit, sign in pairs if limit in node)
    return f"{kind} {signs}".strip()


def _place(model: type[Settings], location: tuple[int | str, ...]) -> tuple[list[str], list[str]]:
    """Return the keys that lead to a problem, and the keys that are allowed there (JSON Schema).

    If a key `kind` chooses between sections, pydantic adds the choice to its locations. The choice
    is left out here, because it is not a key of the user's file.
    """
    schema = _schema(model)
    path, options = [], [schema]
    for key in location:
        if of_kind := [option for option in options if _kind(option) == key]:
            options = of_kind
            continue
        path.append(str(key))
        node = options[0] if options else {}
        inner = node.get("items") if isinstance(key, int) else node.get("properties", {}).get(key)
        options = _sections(inner or {}, schema)
    return path, list(options[0].get("properties", {})) if options else []


def _sections(node: Mapping[str, Any], schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the schemas that a value may match, with references resolved and sections first."""
    if "$ref" in node:
        return [schema["$defs"][node["$ref"].rsplit("/", 1)[1]]]
    choices = node.get("anyOf", node.get("oneOf"))
    if choices is None:
        return [node]
    sections = [section for option in choices for section in _sections(option, schema)]
    return sorted(sections, key=lambda section: "properties" not in section)


def _kind(section: Mapping[str, Any]) -> str | None:
    if section.get("type") == "array":
        return "list"  # pydantic's tag of a list among sections of several kinds
    return section.get("properties", {}).get("kind", {}).get("const")
