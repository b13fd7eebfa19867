"""Sources of the numbers in a scanner's file, from the comment after each number."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import takewhile

import yaml

from ..former_names import current_name
from .entry import base_of

# The comment after a number begins with the words of its class; the best class comes first.
CLASSES: Mapping[str, str] = {
    "source": "source: ",
    "quoted": "quoted: ",
    "memory": "from memory of ",
    "choice": "our choice",
}
LEGEND = (
    "[source] a document that can be cited, [quoted] a public quotation of one, [memory] recalled "
    "from a datasheet and not checked, [choice] our choice; the rest is computed or simulated"
)
_GEOMETRY = ("camera", "projector", "baseline_m", "toe_in_deg", "near_m", "far_m")
_WORDS = ("likeness", "laser", "base")  # The values of these keys are neither numbers nor lights.


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedNumber:
    """A number in a scanner's file with its key, text and class, and the comment after it."""

    key: str
    text: str
    kind: str
    comment: str


@cache
def stated_numbers(name: str) -> Mapping[str, StatedNumber]:
    """Return the numbers in a scanner's file by their keys, such as `claims.fields.0.at_m`.

    The rig `paper` has the geometry of `like-phoxi-m`, so its numbers come from that file. A
    section, such as `claims`, comes from the scanner's file or else from its base.

    Raises:
        ValueError: the comment after a number names no class.
    """
    text = _file_text(name)
    lines = text.splitlines()
    stated = {}
    for key, node in _leaves(yaml.compose(text, Loader=yaml.SafeLoader), ""):
        written = lines[node.start_mark.line][node.start_mark.column :]
        value, _, comment = written.partition("  # ")
        kinds = [kind for kind, start in CLASSES.items() if comment.startswith(start)]
        if not kinds:
            raise ValueError(f"{name}.yaml: {key} has no class: state where {value} is from")
        stated[key] = StatedNumber(key=key, text=value, kind=kinds[0], comment=comment)
    content = yaml.safe_load(text)
    if (base := base_of(name, content.get("base"))) is None:
        return stated
    theirs = {
        key: stated.get(key, number)
        for key, number in stated_numbers(base).items()
        if key in stated or key.split(".")[0] not in content
    }
    return theirs | stated


def _file_text(name: str) -> str:
    """Return the text of the file that contains a scanner's numbers."""
    file = "like-phoxi-m" if name == "paper" else current_name(name)
    return files(__package__).joinpath(f"{file}.yaml").read_text(encoding="utf-8")


def _leaves(node: yaml.Node, key: str) -> Iterator[tuple[str, yaml.Node]]:
    """Yield each number, list of numbers and colour of light below a YAML node, with its key."""
    items: list[tuple[str, yaml.Node]] = []
    if isinstance(node, yaml.MappingNode):
        items = [(str(name.value), inner) for name, inner in node.value]
    elif isinstance(node, yaml.SequenceNode) and not node.flow_style:
        items = [(str(i), inner) for i, inner in enumerate(node.value)]
    for name, inner in items:
        if name not in _WORDS:
            yield from _leaves(inner, f"{key}.{name}" if key else name)
    if not items:
        yield key, node


def class_of(name: str, *keys: str) -> str:
    """Return the weakest class among the given keys; keys that the file lacks are ignored."""
    stated = stated_numbers(name)
    kinds = [stated[key].kind for key in keys if key in stated]
    return max(kinds, key=list(CLASSES).index)


def source_lines(name: str) -> list[str]:
    """Return a line for each number in a scanner's file; it ends with the class and the source.

    The comment at the head of the file, which explains the names of the sources, comes first. For
    the rig `paper`, only the geometry comes from a file.
    """
    lines = _file_text(name).splitlines()
    head = [line[2:] for line in takewhile(lambda line: line[:1] == "#", lines)]
    numbers = list(stated_numbers(name).values())
    if name == "paper":
        head = [
            "The geometry is that of like-phoxi-m; light, lens, code and filters are our choice."
        ]
        numbers = [number for number in numbers if number.key.split(".")[0] in _GEOMETRY]
    return [*head, *(f"{number.key}: {number.text}  # {number.comment}" for number in numbers)]
