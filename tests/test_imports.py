"""Which module may import which: the one table of the package's arrows (STYLE.md, section 2)."""

import ast
import re
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "graycast"

# Each line may import from the lines above it, but for what is named under `FORBIDDEN`.
ORDER = (
    "errors",
    "array_types",
    "file_limits",
    "folder",
    "plotting",
    "settings",
    "usage",
    "color",
    "frames",
    "lens_inverse",
    "mask_box",
    "optics",
    "raster",
    "finish",
    "ply",
    "pattern",
    "rig",
    "parts",
    "grasp",
    "bins",
    "scene",
    "drop",
    "render",
    "camera_light",
    "sensor",
    "speckle",
    "photon_transfer",
    "decode",
    "line_noise",
    "faults",
    "scanner",
    "picture",
    "rig_file",
    "stack",
    "dataset",
    "detections",
    "pose_results",
    "domain",
    "views",
    "config",
    "cell",
    "simulate",
    "engine",
    "generate",
    "metrology",
    "stats",
    "card",
    "export",
    "real",
    "training",
    "evaluate",
    "detect",
    "pose",
    "merge",
    "study_file",
    "study",
    "design",
    "pick",
    "grasp_labels",
    "report",
    "live",
    "doctor",
    "cli",
)
FORBIDDEN = {
    "render": {"drop"},
    "sensor": {"drop", "render"},
    "decode": {"drop", "render"},
    "dataset": {"drop"},
    "metrology": {"drop", "dataset", "config", "cell", "simulate", "generate"},
    "evaluate": {"drop", "render", "sensor", "decode", "simulate", "generate"},
    "detect": {"drop", "render", "sensor", "decode", "simulate", "generate"},
    "pose": {"drop", "render", "sensor", "decode", "dataset", "simulate", "generate", "evaluate"},
    "doctor": {"drop", "dataset", "decode", "sensor", "simulate", "generate", "report"},
}
WHOLE_LINE = {"simulate", "generate", "report", "live", "cli"}
# The truth is the renderer's, so the dataset takes its values, but no back end.
ONLY_VALUES = {"dataset": {"render": {"render", "render.radiance"}}}


def modules():
    """Dotted name below the package, file, and whether it is a folder's `__init__`."""
    for file in sorted(SOURCE.rglob("*.py")):
        parts = file.relative_to(SOURCE).with_suffix("").parts
        yield parts[:-1] if parts[-1] == "__init__" else parts, file, parts[-1] == "__init__"


@cache
def import_nodes(file):
    """The statements that import, anywhere in a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def imports(name, file, is_folder):
    """Dotted names below the package that a file imports, anywhere in it."""
    package = name if is_folder else name[:-1]
    for node in import_nodes(file):
        if isinstance(node, ast.Import):
            dotted = [alias.name.split(".") for alias in node.names]
            yield from (tuple(d[1:]) for d in dotted if d[0] == "graycast")
        elif isinstance(node, ast.ImportFrom):
            base = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                base = package[: len(package) - node.level + 1] + base
            elif base[:1] != ("graycast",):
                continue
            else:
                base = base[1:]
            for alias in node.names:
                deeper = SOURCE.joinpath(*base, alias.name)
                exists = deeper.is_dir() or deeper.with_suffix(".py").is_file()
                yield (*base, alias.name) if exists else base


def broken_arrows(name, targets):
    """What a module of that name may not import; the door shows the whole house."""
    if not name:
        return set()
    top = name[0]
    above = set(ORDER[: ORDER.index(top)]) - FORBIDDEN.get(top, set())
    wrong = set()
    for target in targets:
        if not target or target[0] == top:  # the package's version; a folder's own files
            continue
        allowed = ONLY_VALUES.get(top, {}).get(target[0], {".".join(target)})
        if target[0] not in above or ".".join(target) not in allowed:
            wrong.add(".".join(target))
    return wrong


def test_every_module_has_its_place_in_the_table():
    tops = {name[0] for name, _, _ in modules() if name} - {"__main__"}
    assert tops <= set(ORDER), f"give {sorted(tops - set(ORDER))} a line in ORDER"


def test_a_module_imports_only_from_modules_above_it():
    """One test for all of them: as a case each they took as long to be told of as to be read."""
    broken = {
        ".".join(name): wrong
        for name, file, is_folder in modules()
        if name != ("__main__",)
        and (wrong := broken_arrows(name, set(imports(name, file, is_folder))))
    }
    assert not broken, "\n".join(f"{name} may not import {sorted(broken[name])}" for name in broken)


def test_what_a_real_scanner_brings_shares_files_and_nothing_else():
    """Calibration, bin, labels and figures are rooms apart; a twin is judged by figures."""
    rooms = {name[1] for name, _, _ in modules() if name[:1] == ("real",) and name[2:]}
    assert rooms == {"calibrate", "fit_bin", "import_real", "realism", "twin"}
    known = {"twin": {"twin", "realism"}}
    for name, file, is_folder in modules():
        if name[:1] == ("real",):
            inside = {t[1] for t in imports(name, file, is_folder) if t[:1] == ("real",) and t[1:]}
            own = known.get(name[1], {name[1]}) if name[1:] else set()
            assert not inside & rooms - own, ".".join(name)


def test_the_door_shows_every_room_in_its_order():
    """The map is the docstring of `graycast/__init__.py`: a line a room."""
    tree = ast.parse((SOURCE / "__init__.py").read_text(encoding="utf-8"))
    lines = re.findall(r"^    (\w+) {2,}\S.*$", ast.get_docstring(tree), re.MULTILINE)
    assert tuple(lines) == ORDER


def test_no_room_comes_in_by_the_door():
    """`from graycast import Scene` inside the package would hide an arrow from the table."""
    for name, file, is_folder in modules():
        package = name if is_folder else name[:-1]
        for node in import_nodes(file) if name else ():
            if not isinstance(node, ast.ImportFrom):
                continue
            to_door = node.module is None and node.level == len(package) + 1
            if to_door or (node.module == "graycast" and not node.level):
                rooms = {a.name for a in node.names if a.name in ORDER or a.name == "__version__"}
                assert {a.name for a in node.names} == rooms, ".".join(name)


def test_only_the_modules_named_see_the_whole_line():
    """The products of physics, light and files meet nowhere else."""
    for name, file, is_folder in modules():
        if name and name[0] not in WHOLE_LINE | {"__main__"}:
            seen = {t[0] for t in imports(name, file, is_folder) if t}
            assert not {"drop", "render", "dataset"} <= seen


def test_the_table_notices_a_wrong_arrow(tmp_path):
    """Relative, absolute and nested imports, of a later module and of a forbidden one."""
    file = tmp_path / "wrong.py"
    file.write_text(
        "from ..drop import drop\nimport graycast.cli\nfrom .. import scene\n"
        "def f():\n    from graycast.decode import decode\n"
    )
    found = set(imports(("render", "wrong"), file, False))
    assert broken_arrows(("render", "wrong"), found) == {"drop", "cli", "decode"}


def test_mitsuba_and_drjit_are_imported_inside_render_alone():
    """Elsewhere they would be loaded before a device was chosen."""
    for name, file, _ in modules():
        if name and name[0] in ("render", "doctor"):
            continue
        for node in import_nodes(file):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {n.split(".")[0] for n in names} & {"mitsuba", "drjit"}, ".".join(name)
