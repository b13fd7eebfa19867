"""Check the scripts of the pages with TypeScript and the types in their JSDoc."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from graycast.show.live import server
from graycast.show.report.page import dataset_page as page
from graycast.show.report.picks import picks_page as picks

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "graycast"
WEB = SOURCE / "show/report/page/web"
TYPES = sorted(SOURCE.rglob("*.d.ts"))
OPTIONS = {
    "allowJs": True,
    "checkJs": True,
    "noEmit": True,
    "target": "es2023",
    "lib": ["es2023", "dom", "dom.iterable"],
    "types": [],
    "noFallthroughCasesInSwitch": True,
    "noImplicitReturns": True,
    "noImplicitThis": True,
    "noUnusedLocals": True,
}
# These are the scripts of each page, except the script that contains its data.
PAGES = {
    "page": (WEB, ("core.js", *page._WEB.scripts, "app.js")),
    "picks": (SOURCE / "show/report/picks/web", ("core.js", *picks._WEB.scripts, "app.js")),
    "live": (
        SOURCE / "show/live/web",
        tuple(name for name in (*server._SHARED, *server._OWN) if name.endswith(".js")),
    ),
    "documentation": (ROOT / "docs", ("iframe-worker.js",)),
}


def run(tool, *arguments):
    node, program = shutil.which("node"), ROOT / ".venv-javascript/node_modules" / tool
    if node is None or not program.is_file():
        pytest.skip("needs TypeScript's checker and Prettier, which need npm: make javascript")
    command = [node, str(program), *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def scripts(name):
    """Return the scripts of a page: its own scripts, and those of the dataset's page."""
    folder, names = PAGES[name]
    return [folder / one if (folder / one).is_file() else WEB / one for one in names]


def checked(folder, files):
    """Return the output of TypeScript's checker for scripts that one page loads."""
    settings = folder / "tsconfig.json"
    files = [str(one) for one in (*TYPES, *files)]
    settings.write_text(json.dumps({"compilerOptions": OPTIONS, "files": files}))
    return run("typescript/bin/tsc", "--pretty", "false", "-p", settings)


@pytest.mark.parametrize("name", PAGES)
def test_the_scripts_of_a_page_have_no_type_errors(name, tmp_path):
    done = checked(tmp_path, scripts(name))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("scene.depth_scale_mm", "scene.depth_scale_m"),  # This field does not exist.
        ("Graycast.toWorld(scene, 0, 0, 0)", "Graycast.toWorld(scene, 0, 0)"),
        ("Graycast.colormap(map)", "Graycast.colourmap(map)"),
        ("scene.depth_scale_mm / (2 * limit)", "scene.depth_scale_mm / (2 * 'limit')"),
    ],
)
def test_a_wrong_name_or_number_of_arguments_is_detected(right, wrong, tmp_path):
    """If the types were not read, the check would accept any error in the scripts."""
    broken = []
    for path in scripts("page"):
        text = path.read_text(encoding="utf-8")
        broken.append(tmp_path / path.name)
        broken[-1].write_text(text.replace(right, wrong, 1), encoding="utf-8")
    done = checked(tmp_path, broken)
    assert done.returncode != 0 and "error TS" in done.stdout


def test_every_script_is_formatted_and_belongs_to_a_page():
    there = sorted({*SOURCE.rglob("*.js"), *(ROOT / "docs").glob("*.js")})
    assert set(there) == {path for name in PAGES for path in scripts(name)}
    done = run("prettier/bin/prettier.cjs", "--check", *there, *TYPES)
    assert done.returncode == 0, done.stdout + done.stderr
