"""A new gripper needs its class and its name in `tools.py`; no other module may name it."""

import re
from pathlib import Path
from typing import get_args

import pytest

import graycast
from graycast.robot.pick.bin.pick_sections import PickConfig
from graycast.robot.pick.tool.tools import AnyTool, Tool

SOURCE = Path(graycast.__file__).parent
TOOLS = get_args(get_args(AnyTool)[0])
DEFAULT = type(PickConfig.model_fields["tool"].default)


def files_that_name(tool):
    word = re.compile(rf"\b{tool.__name__}\b")
    for file in SOURCE.rglob("*.py"):
        if word.search(file.read_text(encoding="utf-8")):
            yield file.relative_to(SOURCE.parent).with_suffix("").as_posix().replace("/", ".")


@pytest.mark.slow
def test_only_the_modules_that_define_and_select_a_tool_name_the_tool():
    """The module of the settings also names the default tool of a cell."""
    for tool in TOOLS:
        settings = {PickConfig.__module__} if tool is DEFAULT else set()
        assert set(files_that_name(tool)) == {tool.__module__, Tool.__module__} | settings


def test_every_tool_implements_all_methods():
    for tool in TOOLS:
        assert isinstance(tool(kind=get_args(tool.model_fields["kind"].annotation)[0]), Tool)
