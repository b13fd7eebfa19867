"""The dependencies in pyproject.toml match the imports, and their versions were tested."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from parsed import nodes_of

from graycast.cli import doctor

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
# Names of packages in the registry that differ from the imported names.
IMPORTED = {
    "PyYAML": "yaml",
    "opencv-python-headless": "cv2",
    "nvidia-ml-py": "pynvml",
    "pillow": "PIL",
    "pin": "pinocchio",
    "scikit-learn": "sklearn",
    "rerun-sdk": "rerun",
}
# These come with Blender's Python or, as Coal does with Pinocchio, with another package.
ELSEWHERE = {"bpy", "mathutils", "_cycles", "coal"}
BY_HAND = {"libreyolo"}  # pyproject.toml explains why.


def wanted(*lists):
    return [Requirement(text) for names in lists for text in names]


def imported_by(folder):
    """Return the top-level names of the external packages that a folder's files import."""
    packages = set()
    for file in folder.rglob("*.py"):
        if "worker" in file.parts:  # Scripts for Blender's Python import each other.
            continue
        for node in nodes_of(file):
            if isinstance(node, ast.Import):
                packages |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                packages.add(node.module.split(".")[0])
    return packages - set(sys.stdlib_module_names) - {"graycast"}


def test_each_dependency_is_imported_and_each_import_is_a_dependency():
    """lxml, networkx and mapbox-earcut once were dependencies that no file imported."""
    of_use = [EXTRAS[name] for name in ("parquet", "ray", "detect", "pick", "twin", "ros", "rerun")]
    dependencies = {IMPORTED.get(r.name, r.name) for r in wanted(PROJECT["dependencies"], *of_use)}
    dependencies = {name.replace("-", "_") for name in dependencies}
    assert imported_by(ROOT / "src") - ELSEWHERE - BY_HAND == dependencies


def test_constraints_contain_only_names_and_versions():
    """The file has no registry addresses, no options and no repeated lines."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.+]*", line) for line in lines)
    assert len({line.split("==")[0].lower() for line in lines}) == len(lines)


def test_a_tested_version_is_stated_for_each_dependency_and_meets_its_requirement():
    stated = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    stated = {name.lower().replace("_", "-"): version for name, version in stated.items()}
    for requirement in wanted(PROJECT["dependencies"], *EXTRAS.values()):
        version = stated[requirement.name.lower()]
        assert requirement.specifier.contains(version), f"{requirement} is constrained to {version}"


@pytest.mark.parametrize("name", ["mitsuba", "drjit", "rapier3d"])
def test_dependencies_that_affect_pictures_or_layouts_have_an_upper_bound(name):
    (requirement,) = (r for r in wanted(PROJECT["dependencies"]) if r.name == name)
    assert {"<", ">="} == {part.operator for part in requirement.specifier}


def test_all_files_state_the_same_versions_of_python():
    """pip once accepted Python 3.14, which setup refuses because some packages have no wheels."""
    python_versions = SpecifierSet(PROJECT["requires-python"])
    allowed = [minor for minor in range(30) if f"3.{minor}" in python_versions]
    assert allowed == list(range(allowed[0], allowed[-1] + 1))
    low, high = allowed[0], allowed[-1]
    setup = (ROOT / "scripts" / "setup").read_text(encoding="utf-8")
    assert f"(3, {low}) <= sys.version_info < (3, {high + 1})" in setup
    for name in ("scripts/setup", "scripts/release", "README.md", "CONTRIBUTING.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        stated = re.findall(r"Python 3\.(\d+) to 3\.(\d+)", text)
        assert stated and set(stated) == {(str(low), str(high))}, name
    for name in ("setup", "release"):
        text = (ROOT / "scripts" / name).read_text(encoding="utf-8")
        assert {int(minor) for minor in re.findall(r"python3\.(\d+)(?!\S*-venv)\b", text)} >= {
            *allowed
        }
    assert doctor._OLDEST_PYTHON == (3, low)
