"""Type checkers accept the code that developers and users read."""

import ast
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from parsed import nodes_of

ROOT = Path(__file__).resolve().parents[1]


def test_the_type_checker_reads_every_module():
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]
    assert not any("ignore_errors" in override for override in tool["overrides"])
    assert tool["exclude"] == ["rendering/cycles/worker/"]  # Blender's Python runs these.
    assert tool["check_untyped_defs"] and tool["warn_unused_ignores"]


def test_the_package_is_marked_as_typed():
    assert (ROOT / "src/graycast/py.typed").is_file()


def name_of(function):
    """Return the last name of a called expression, such as `Field` for `pydantic.Field`."""
    return getattr(function, "attr", None) or getattr(function, "id", None)


def test_no_default_of_a_field_is_positional():
    """Type checkers treat a field as required unless its default is a keyword argument."""
    calls = [
        (path.relative_to(ROOT), call)
        for path in sorted((ROOT / "src").rglob("*.py"))
        for call in nodes_of(path)
        if isinstance(call, ast.Call) and name_of(call.func) == "Field"
    ]
    assert len(calls) > 300
    assert not [f"{path}:{call.lineno}" for path, call in calls if call.args]


# --- what a user writes --------------------------------------------------------------------------

PYTHON_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# An editor must underline each of these lines; otherwise, the checks below prove nothing.
WRONG = """\
import graycast as gc

cell = gc.load_cell("configs/demo.yaml")
gc.MaterialSection(rouhgness=0.4)
gc.MaterialSection(roughness="matt")
gc.SensorSection(read_noise=3.0)
gc.Config(parts=gc.PartSection(builtin="toothpaste"))
gc.Config()
gc.scenes(cell, "3")
next(gc.scenes(cell, 3)).depths
gc.open_examples("out/demo")[0].colour
for example in gc.open_examples("out/demo"):
    example.colour
"""
WRONG_LINES = [k for k, line in enumerate(WRONG.splitlines(), 1) if k > 3 and line[:3] != "for"]


def python_of(page):
    """Return the Python code of a page, in which each line keeps its line number."""
    text = page.read_text(encoding="utf-8")
    lines = [""] * (text.count("\n") + 1)
    for block in PYTHON_BLOCK.finditer(text):
        first = text[: block.start(1)].count("\n")
        code = block[1].splitlines()
        lines[first : first + len(code)] = code
    return "\n".join(lines) if any(lines) else ""


@pytest.fixture(scope="module")
def user_files(tmp_path_factory):
    """Write all code of the documentation and of the examples as a user's modules."""
    folder = tmp_path_factory.mktemp("user")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        if code := python_of(page):
            name = re.sub(r"\W", "_", str(page.relative_to(ROOT).with_suffix("")))
            (folder / f"{name}.py").write_text(code + "\n", encoding="utf-8")
    for example in sorted((ROOT / "examples").glob("*.py")):
        shutil.copy(example, folder / f"example_{example.name}")
    (folder / "wrong.py").write_text(WRONG, encoding="utf-8")
    assert len(list(folder.iterdir())) > 15
    return folder


def refuse_errors(errors):
    """Fail for an error (file, line, text) in correct code, and for a wrong line without one."""
    assert sorted({line for name, line, _ in errors if name == "wrong.py"}) == WRONG_LINES
    assert not [error for error in errors if error[0] != "wrong.py"]


@pytest.mark.slow
def test_mypy_without_plugins_accepts_every_page_and_example(user_files):
    settings = user_files / "mypy.ini"  # Many other libraries have no types.
    settings.write_text("[mypy]\nignore_missing_imports = true\n", encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", settings, "--no-error-summary"]
    command += ["--cache-dir", ROOT / ".mypy_cache/pages", "--hide-error-context", user_files]
    done = subprocess.run(command, cwd=user_files, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    errors = re.findall(r"^(.+?):(\d+): error: (.*)$", done.stdout, re.MULTILINE)
    refuse_errors([(Path(name).name, int(line), text) for name, line, text in errors])


@pytest.mark.slow
def test_pyright_accepts_every_page_and_example(user_files):
    node, program = shutil.which("node"), ROOT / ".venv-javascript/node_modules/pyright/index.js"
    if node is None or not program.is_file():
        pytest.skip("needs Pyright, which needs npm: make javascript")
    settings = {"reportMissingImports": "none", "reportMissingModuleSource": "none"}
    (user_files / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    command = [node, program, "--outputjson", "--pythonpath", sys.executable, "-p", user_files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    errors = json.loads(done.stdout)["generalDiagnostics"]
    refuse_errors(
        [
            (Path(one["file"]).name, one["range"]["start"]["line"] + 1, one["message"])
            for one in errors
            if one["severity"] == "error"
        ]
    )
