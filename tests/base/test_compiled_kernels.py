"""Compiled kernels are reused only while their whole source is unchanged."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from parsed import nodes_of

import graycast
from graycast.base import kernels
from graycast.base.kernels import (
    MOST_VERSIONS,
    all_imported_modules,
    kernel,
    kernel_folder,
    package_files,
    sources_digest,
)

PACKAGE = Path(graycast.__file__).parent
WITH_KERNELS = sorted(
    name for name, file in package_files().items() if "import kernel" in file.read_text()
)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Write a package of three modules: a kernel, one that it imports, and one that it does not."""
    files = {
        "toy.shape": "from .sizes import area\n\ndef volume(x):\n    return x * area(x)\n",
        "toy.sizes": "from graycast.toy import factors\n\ndef area(x):\n    return factors.K * x\n",
        "toy.factors": "K = 2.0\n",
        "toy.other": "K = 5.0\n",
    }
    names = {f"graycast.{name}": tmp_path / f"{name}.py" for name in files}
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(kernels, "package_files", lambda: names)
    monkeypatch.setattr(kernels, "_START_NS", 2**63)
    forget()
    yield {name.removeprefix("graycast.toy."): file for name, file in names.items()}
    forget()


def forget():
    for cached in (kernels.imported_modules, kernels._content_digest, sources_digest):
        cached.cache_clear()


@pytest.mark.parametrize(
    ("changed", "same"),
    [("shape", False), ("sizes", False), ("factors", False), ("other", True)],
)
def test_a_changed_constant_in_an_imported_file_changes_the_kernel_digest(package, changed, same):
    before = sources_digest("graycast.toy.shape")
    package[changed].write_text(package[changed].read_text() + "K = 3.0\n")
    forget()
    assert (sources_digest("graycast.toy.shape") == before) is same


def test_no_kernel_is_stored_if_its_source_changed_after_the_process_started(package, monkeypatch):
    """The process still has the old code, which must not be stored under the new text's digest."""
    began_ns = max(os.stat(file).st_ctime_ns for file in package.values())
    monkeypatch.setattr(kernels, "_START_NS", began_ns)
    assert sources_digest("graycast.toy.shape") is not None
    forget()
    monkeypatch.setattr(kernels, "_START_NS", began_ns - 1)
    newest = max(package, key=lambda name: os.stat(package[name]).st_ctime_ns)
    assert sources_digest(f"graycast.toy.{newest}") is None


def imports_of_syntax(module: str) -> set[str]:
    """Return the modules of the package that a module imports, from its syntax tree."""
    file, names = package_files()[module], set()
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in nodes_of(file):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            start = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                start = ".".join([*above, *start.split(".")]).rstrip(".")
            names |= {start, *(f"{start}.{alias.name}" for alias in node.names)}
    return names & package_files().keys()


@pytest.mark.slow
def test_a_digest_covers_every_import_that_python_s_parser_reads():
    """Oracle: Python's own parser."""
    assert len(WITH_KERNELS) > 25
    sources = {name for module in WITH_KERNELS for name in all_imported_modules(module)}
    for module in sorted(sources):
        assert kernels.imported_modules(module) >= imports_of_syntax(module), module


def test_the_digest_of_a_kernel_covers_the_files_of_imported_constants():
    sources = all_imported_modules("graycast.camera.decode.outliers")
    assert {"graycast.base.robust", "graycast.camera.decode.median"} <= {*sources}


@kernel()
def _doubled(x):
    return 2 * x


class Opened:
    """A kernel's cache in its own folder, as a process of the package has it."""

    def __init__(self, monkeypatch, folder, digest="0" * 16):
        monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(folder))
        monkeypatch.setattr(kernels, "sources_digest", lambda module: digest)
        monkeypatch.setattr(kernels, "package_files", lambda: {__name__: Path(__file__)})
        self.function = kernel()(_doubled.py_func)

    def __call__(self, x):
        return self.function(x), sum(self.function.stats.cache_hits.values())


def files(folder, pattern="*.nbc"):
    return sorted(folder.rglob(pattern))


def test_a_kernel_is_loaded_from_the_folder_of_its_digest(monkeypatch, tmp_path):
    assert Opened(monkeypatch, tmp_path)(3) == (6, 0)
    assert Opened(monkeypatch, tmp_path)(3) == (6, 1)
    assert Opened(monkeypatch, tmp_path, "1" * 16)(3) == (6, 0)
    assert {file.parent.name for file in files(tmp_path)} == {
        f"{__name__}-{digit * 16}" for digit in "01"
    }


@pytest.mark.parametrize("pattern", ["*.nbc", "*.nbi"])
@pytest.mark.parametrize("content", [b"", b"no pickle", None])
def test_a_kernel_with_a_damaged_file_is_compiled_again(monkeypatch, tmp_path, pattern, content):
    Opened(monkeypatch, tmp_path)(3)
    (file,) = files(tmp_path, pattern)
    file.write_bytes(file.read_bytes()[:40] if content is None else content)
    assert Opened(monkeypatch, tmp_path)(3) == (6, 0)
    assert Opened(monkeypatch, tmp_path)(3) == (6, 1)


def test_processes_that_store_kernels_at_once_keep_one_file_per_signature(monkeypatch, tmp_path):
    """Both processes read the empty index; each signature then finds its own code or none."""
    first, second = Opened(monkeypatch, tmp_path), Opened(monkeypatch, tmp_path)
    for opened in (first, second):
        monkeypatch.setattr(opened.function._cache._disk._cache_file, "_load_index", dict)
    assert (first(3)[0], second(3.5)[0]) == (6, 7.0)
    assert len(files(tmp_path)) == 2
    for x in (3, 3.5):
        result, hits = Opened(monkeypatch, tmp_path)(x)
        assert result == 2 * x and type(result) is type(x) and hits <= 1


def test_only_the_most_recent_kernel_versions_are_kept(monkeypatch, tmp_path):
    folders = [tmp_path / f"{__name__}-{number:016x}" for number in range(MOST_VERSIONS + 3)]
    others = [tmp_path / f"{__name__}s-{0:016x}", tmp_path / "mine"]
    for age, folder in enumerate(folders + others):
        folder.mkdir()
        (folder / "a.nbc").write_bytes(b"")
        os.utime(folder, (1e9 - age, 1e9 - age))
    Opened(monkeypatch, tmp_path, "f" * 16)(3)
    new = tmp_path / f"{__name__}-{'f' * 16}"
    assert {*tmp_path.iterdir()} == {*folders[: MOST_VERSIONS - 1], *others, new}


def test_a_kernel_is_compiled_even_if_no_folder_is_writable(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the place of a folder")
    assert Opened(monkeypatch, tmp_path / "file" / "kernels")(3) == (6, 0)
    monkeypatch.setattr(kernels, "kernel_folder", lambda: None)
    assert Opened(monkeypatch, tmp_path)(3) == (6, 0)
    assert files(tmp_path) == []


def test_a_deleted_cache_folder_or_a_full_disk_does_not_stop_a_run(monkeypatch, tmp_path):
    opened = Opened(monkeypatch, tmp_path)
    opened(3)
    shutil.rmtree(tmp_path)
    assert opened(3.5) == (7.0, 0)

    def full(*args):
        raise OSError(28, "No space left on device")

    opened = Opened(monkeypatch, tmp_path)
    monkeypatch.setattr(opened.function._cache._disk._cache_file, "_save_data", full)
    assert opened(3) == (6, 0)


def test_the_kernel_cache_is_in_numba_s_folder_or_else_in_the_xdg_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert kernel_folder() == tmp_path / "numba"
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", "")
    assert kernel_folder() == tmp_path / "xdg" / "graycast" / "kernels"


PROGRAM = """
import numpy as np
from graycast.camera.decode.outliers import _outlies
rng = np.random.default_rng(0)
maps = 1 + 1e-3 * rng.standard_normal((5, 5)), np.full((5, 5), 1e-9)
hits = lambda: sum(_outlies.stats.cache_hits.values())
print(*_outlies(*maps, 2, 2, 2.0, 0.0), *_outlies.py_func(*maps, 2, 2, 2.0, 0.0), hits())
"""


@pytest.mark.slow
def test_a_changed_constant_in_an_imported_file_takes_effect_despite_the_cache(tmp_path):
    """Oracle: the same function run by Python. Numba's own cache would use the old constant."""
    tree = tmp_path / "graycast"
    shutil.copytree(PACKAGE, tree, ignore=shutil.ignore_patterns("__pycache__"))
    env = os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    env.pop("NUMBA_CACHE_DIR", None)
    robust = tree / "base" / "robust.py"
    text = robust.read_text()

    def run():
        command = [sys.executable, "-c", PROGRAM]
        output = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
        words = output.split()
        return words[:3], words[3:6], int(words[6])

    compiled, plain, hits = run()
    assert compiled == plain and hits == 0
    again, _, hits = run()
    assert again == compiled and hits == 1
    line = next(line for line in text.splitlines() if line.startswith("MAD_SIGMA = "))
    robust.write_text(text.replace(line, "MAD_SIGMA = 1e-6"))
    changed, plain, hits = run()
    assert changed == plain and hits == 0
    assert changed != compiled
    robust.write_text(text)
    back, _, hits = run()
    assert back == compiled and hits == 1
    assert not [*tree.rglob("*.nb[ic]")]
    assert np.isfinite(float(back[1]))
