"""The table of `scripts/break-it` fits the source that it breaks."""

import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """A copy, as Python would leave a compiled file beside the script."""
    path = tmp_path_factory.mktemp("script") / "break_it.py"
    path.write_bytes((ROOT / "scripts/break-it").read_bytes())
    loader = SourceFileLoader("break_it", str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("break_it", loader))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "break_it", module)  # dataclasses look there
        loader.exec_module(module)
    return module


def test_each_bug_can_be_put_in_and_has_tests(script):
    names = [bug.bug for bug in script.BUGS]
    assert len(set(names)) == len(names)
    for bug in script.BUGS:
        source = (ROOT / "src/graycast" / bug.file).read_text(encoding="utf-8")
        assert source.count(bug.text) == 1, bug.bug
        compile(source.replace(bug.text, bug.replaced_by), bug.file, "exec")
        for test in bug.tests.split():
            file, _, name = test.partition("::")
            assert f"def {name}" in (ROOT / "tests" / file).read_text(encoding="utf-8"), bug.bug
