"""Which modules the type checker still looks past; `make test` runs the checker itself."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_checker_looks_at_every_module():
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]
    assert not any("ignore_errors" in override for override in tool["overrides"])
    assert tool["exclude"] == ["rendering/cycles/worker/"]  # scripts of Blender's Python
    assert tool["check_untyped_defs"] and tool["warn_unused_ignores"]


def test_who_uses_the_package_is_told_that_it_has_types():
    assert (ROOT / "src/graycast/py.typed").is_file()


def test_no_default_of_a_field_is_positional():
    """Type checkers know a pydantic default by its keyword, and else take the key as required."""
    calls = [
        (path.relative_to(ROOT), call)
        for path in sorted((ROOT / "src").rglob("*.py"))
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and ast.unparse(call.func).split(".")[-1] == "Field"
    ]
    assert len(calls) > 300
    assert not [f"{path}:{call.lineno}" for path, call in calls if call.args]
