"""CONTRIBUTING.md lists all files that each kind of extension changes; they exist and are few."""

import ast
import re
from collections import defaultdict
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import get_args

import pytest
from parsed import nodes_of

from graycast.cli import dataset_commands
from graycast.learn.detect.networks import MODELS
from graycast.rig.pattern.spec import Codec

ROOT = Path(__file__).resolve().parents[1]
MOST_FILES = 3
# This file exports the functions that make codes by name.
KNOWING = {"src/graycast/rig/pattern/__init__.py"}
NAMES = {
    "code": set(get_args(Codec)) - {"gray", "gray_phase"},  # "gray" is also a kind of picture.
    "renderer": {"cycles"},
    "detector": set(MODELS) - {"mask-rcnn"},  # This is the default for training.
    "exporter": set(dataset_commands._FORMATS) - {"coco"},  # Other datasets have a file "coco".
}
KINDS = [*NAMES, "statistic of datasets"]


def lines_on() -> dict[str, str]:
    """Return the text about each kind of extension, by kind."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = text.split("## Where new things go")[1].split("\n## ")[0]
    entries = re.findall(r"^- \*\*An? ([\w\- ]+)\*\*(.*?)(?=^- |\Z)", section, flags=re.M | re.S)
    return dict(entries)


def files_for(kind: str) -> set[str]:
    return set(re.findall(r"`(src/graycast/[\w/]+\.py)`", lines_on()[kind]))


@pytest.mark.parametrize("kind", KINDS)
def test_an_extension_touches_at_most_three_files_and_all_of_them_exist(kind):
    files = files_for(kind)
    assert 1 <= len(files) <= MOST_FILES
    assert all((ROOT / name).is_file() for name in files)


@cache
def files_of_texts() -> Mapping[str, set[str]]:
    """Return the files that contain each string constant of the package."""
    files = defaultdict(set)
    for path in (ROOT / "src").rglob("*.py"):
        for node in nodes_of(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                files[node.value].add(path.relative_to(ROOT).as_posix())
    return files


@pytest.mark.parametrize("kind", NAMES)
def test_no_other_file_names_the_existing_extensions(kind):
    knowing = set().union(*(files_of_texts()[name] for name in NAMES[kind]))
    others = knowing - files_for(kind) - KNOWING
    assert {name for name in others if "/rendering/cycles/" not in name} == set()


def test_every_file_that_contributing_names_exists():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`((?:src|tests|examples|configs|docs|benchmarks|studies)/[\w/.]+)`", text)
    assert named and [name for name in named if not (ROOT / name).exists()] == []
