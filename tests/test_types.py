"""Which modules the type checker still looks past; `make test` runs the checker itself."""

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
