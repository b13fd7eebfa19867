"""Check the imports of each module against a single table of allowed imports."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from parsed import nodes_of, tree_of

SOURCE = Path(__file__).resolve().parents[1] / "src" / "graycast"

# A room may import from the rooms above it. The docstring of a room gives the order of its
# modules; modules that it does not name come first.
ROOMS = (
    "base",
    "rig",
    "world",
    "rendering",
    "camera",
    "dataset",
    "cell",
    "score",
    "real",
    "learn",
    "robot",
    "show",
    "cli",
)
# These imports are also forbidden, so that results do not depend on unrelated inputs.
FORBIDDEN = {
    "rendering": {"world.drop"},
    "camera.sensor": {"world.drop", "rendering"},
    "camera.decode": {"world.drop", "rendering"},
    "dataset": {"world.drop"},
    "score.metrology": {
        *("world.drop", "dataset", "cell.config", "cell.resolve", "cell.simulate"),
        "cell.generate",
    },
    "score.evaluate": {
        *("world.drop", "rendering", "camera.sensor", "camera.decode", "cell.simulate"),
        "cell.generate",
    },
    "learn.detect": {
        *("world.drop", "rendering", "camera.sensor", "camera.decode", "cell.simulate"),
        "cell.generate",
    },
    "robot.pose": {
        *("world.drop", "rendering", "camera.sensor", "camera.decode", "dataset", "cell.simulate"),
        *("cell.generate", "score.evaluate"),
    },
    "cli.doctor": {
        *("world.drop", "dataset", "camera.decode", "camera.sensor", "cell.simulate"),
        *("cell.generate", "show.report"),
    },
}
# These modules may use the whole pipeline.
WHOLE_LINE = {"cell.simulate", "cell.generate", "show.report", "show.live", "cli"}
MITSUBA = {"rendering", "cli.doctor"}
# The truth comes from the renderer, so the dataset imports the renderer's values, but no back end.
ONLY_VALUES = {"dataset": {"rendering": {"rendering", "rendering.radiance"}}}


def modules():
    """Yield each module's dotted name in the package, its file, and whether it is an `__init__`.

    `__main__.py` is excluded, because it only runs the command line.
    """
    for file in sorted({*SOURCE.rglob("*.py")} - {SOURCE / "__main__.py"}):
        parts = file.relative_to(SOURCE).with_suffix("").parts
        yield parts[:-1] if parts[-1] == "__init__" else parts, file, parts[-1] == "__init__"


@cache
def import_nodes(file):
    """Return all import statements of a file, including nested statements."""
    return [node for node in nodes_of(file) if isinstance(node, ast.Import | ast.ImportFrom)]


@cache
def order_in(room):
    """Return the modules of a room in the order of its docstring, lowest first."""
    text = ast.get_docstring(tree_of(SOURCE / room / "__init__.py"))
    return tuple(re.findall(r"^    (\w+) {2,}\S.*$", text, re.MULTILINE))


def imports(name, file, is_folder, nodes=None):
    """Yield the dotted names in the package that a file imports, including nested imports."""
    package = name if is_folder else name[:-1]
    for node in import_nodes(file) if nodes is None else nodes:
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


def within(target, places):
    """Return whether a dotted name is one of the places, or is inside one of them."""
    return any(".".join(target[: place.count(".") + 1]) == place for place in places)


def of(name, table):
    """Return all entries of a table for a module, for its folder and for its room."""
    return set().union(*(table.get(".".join(name[:n]), set()) for n in range(1, len(name) + 1)))


def broken_arrows(name, targets):
    """Return the forbidden imports of a module; `graycast/__init__.py` may import everything."""
    if not name:
        return set()
    room = name[0]
    above = ROOMS[: ROOMS.index(room)]
    forbidden = of(name, FORBIDDEN)
    wrong = set()
    for target in targets:
        if not target:  # `graycast` itself is for users; rooms must import from rooms.
            wrong.add("graycast")
            continue
        if target[0] == room:
            allowed = name[1:2] == target[1:2] or not name[1:] or comes_before(target, name)
        else:
            values = ONLY_VALUES.get(room, {}).get(target[0], {".".join(target)})
            allowed = target[0] in above and ".".join(target) in values
        if not allowed or within(target, forbidden):
            wrong.add(".".join(target))
    return wrong


def comes_before(first, second):
    """Return whether the second of two modules in a room may import the first."""
    order = order_in(second[0])
    one, other = (order.index(n[1]) if n[1:] and n[1] in order else -1 for n in (first, second))
    return one < other or one == other == -1


def test_every_module_is_in_the_table_of_imports():
    """Each room is in the table, and each module is in the docstring of its room."""
    tops = {name[0] for name, _, _ in modules() if name}
    assert tops == set(ROOMS), f"give {sorted(tops ^ set(ROOMS))} a line in ROOMS, or none"
    for room in ROOMS:
        inside = {name[1] for name, _, _ in modules() if name[:1] == (room,) and name[1:]}
        assert inside == set(order_in(room)), f"complete {room}/__init__.py"


def test_a_module_imports_only_from_modules_listed_above_it():
    """One test checks all modules, because a test case for each module doubled the time."""
    broken = {
        ".".join(name): wrong
        for name, file, is_folder in modules()
        if (wrong := broken_arrows(name, set(imports(name, file, is_folder))))
    }
    assert not broken, "\n".join(f"{name} may not import {sorted(broken[name])}" for name in broken)


def test_no_modules_import_each_other_in_a_circle():
    """Imports within functions count too."""
    graph = {}
    for name, file, is_folder in modules():
        targets = set(imports(name, file, is_folder, import_nodes(file)))
        if name:
            graph[name] = {target for target in targets if target and target != name}
    TopologicalSorter(graph).prepare()  # This raises CycleError, which names the circle.


def test_packages_for_real_scanners_share_only_files():
    """Each task has its own folder; only `twin` may import another folder, `realism`."""
    folders = {name[1] for name, _, _ in modules() if name[:1] == ("real",) and name[2:]}
    assert folders == {
        "calibrate",
        "fit_bin",
        "import_real",
        "material",
        "realism",
        "rescan",
        "twin",
    }
    known = {"twin": {"twin", "realism"}}
    for name, file, is_folder in modules():
        if name[:1] == ("real",):
            inside = {t[1] for t in imports(name, file, is_folder) if t[:1] == ("real",) and t[1:]}
            own = known.get(name[1], {name[1]}) if name[1:] else set()
            assert not inside & folders - own, ".".join(name)


def test_graycast_lists_all_packages_in_the_order_of_the_table():
    """The docstring of `graycast/__init__.py` has one line for each room."""
    text = ast.get_docstring(tree_of(SOURCE / "__init__.py"))
    assert tuple(re.findall(r"^    (\w+) {2,}\S.*$", text, re.MULTILINE)) == ROOMS


def test_no_package_imports_from_graycast_itself():
    """Within the package, `from graycast import Scene` would hide an import from the table."""
    for name, file, is_folder in modules():
        package = name if is_folder else name[:-1]
        for node in import_nodes(file) if name else ():
            if not isinstance(node, ast.ImportFrom):
                continue
            to_door = node.module is None and node.level == len(package) + 1
            if to_door or (node.module == "graycast" and not node.level):
                rooms = {a.name for a in node.names if a.name in ROOMS}
                assert {a.name for a in node.names} == rooms, ".".join(name)


def test_only_the_named_modules_import_the_whole_pipeline():
    """Only these modules combine results of physics, light and files."""
    line = ("world.drop", "rendering", "dataset")
    for name, file, is_folder in modules():
        if name and not within(name, WHOLE_LINE):
            targets = set(imports(name, file, is_folder))
            assert not all(any(within(t, {place}) for t in targets) for place in line), name


def test_an_import_that_the_table_forbids_is_detected(tmp_path):
    """The imports are relative, absolute or nested; their targets are not allowed."""
    file = tmp_path / "wrong.py"
    file.write_text(
        "from ..world.drop import drop\nimport graycast.cli\nfrom ..world import scene\n"
        "def f():\n    from graycast.camera.decode import decode\n"
    )
    imported = set(imports(("rendering", "wrong"), file, False))
    wrong = {"world.drop", "cli", "camera.decode"}
    assert broken_arrows(("rendering", "wrong"), imported) == wrong
    assert broken_arrows(("world", "parts", "wrong"), {("world", "scene")}) == {"world.scene"}
    assert not broken_arrows(("world", "drop", "wrong"), {("world", "scene")})


def test_mitsuba_and_drjit_are_imported_only_by_allowed_modules():
    """Any other import would load Mitsuba and Dr.Jit before a device is selected."""
    for name, file, _ in modules():
        if name and within(name, MITSUBA):
            continue
        for node in import_nodes(file):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {n.split(".")[0] for n in names} & {"mitsuba", "drjit"}, ".".join(name)
