"""Files for hosts and editors name commands, files and versions that exist."""

import json
import re
from pathlib import Path

import yaml

from graycast.base.version import __version__
from graycast.cli.start_commands import KINDS

ROOT = Path(__file__).resolve().parents[1]


def read_yaml(name: str) -> dict:
    return yaml.safe_load((ROOT / name).read_text())


def test_the_workflow_runs_the_readme_command_with_supported_versions_of_python():
    job = read_yaml(".github/workflows/test.yml")["jobs"]["test"]
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make test"]
    supported = re.search(r"Python ([\d.]+) to ([\d.]*\d)", (ROOT / "README.md").read_text())
    assert supported is not None
    assert job["strategy"]["matrix"]["python"] == list(supported.groups())


def test_the_citation_states_the_version_of_the_program_and_its_licence():
    citation = read_yaml("CITATION.cff")
    assert citation["version"] == __version__
    assert citation["license"] == "Apache-2.0"
    assert citation["references"][0]["title"] in (ROOT / "README.md").read_text().replace("\n", " ")


def test_every_pre_commit_hook_is_also_a_check_of_make_test():
    hooks = [
        hook for repo in read_yaml(".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]
    ]
    makefile = (ROOT / "Makefile").read_text()
    assert [hook["entry"] for hook in hooks if f"\t{hook['entry']}" not in makefile] == []
    assert len(hooks) == 3


def test_editors_find_the_schema_of_each_kind_of_file():
    schemas = json.loads((ROOT / ".vscode/settings.json").read_text())["yaml.schemas"]
    assert [Path(name).stem for name in schemas] == list(KINDS)
    loop = re.search(r"for kind in (.*); do", (ROOT / "Makefile").read_text())
    assert loop is not None and loop[1].split() == list(KINDS)
    in_repository = [glob for globs in schemas.values() for glob in globs if "**" not in glob]
    assert in_repository != []
    assert [glob for glob in in_repository if not list(ROOT.glob(glob))] == []
