"""A folder of results is complete or absent, and the remains of killed runs are deleted."""

import subprocess
import sys

import pytest

from graycast.base.errors import GraycastError
from graycast.base.folder import (
    beside,
    claimed_folder,
    new_folder,
    take_lock,
    whole_folder,
    write_whole,
)

KILLED = """
import os, signal, sys
from pathlib import Path
from graycast.base.folder import new_folder, whole_folder
with globals()[sys.argv[1]](Path(sys.argv[2])) as folder:
    (folder / "half").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("make", [new_folder, whole_folder])
def test_a_run_deletes_the_files_that_a_killed_run_left_behind(tmp_path, make):
    out = tmp_path / "a[b]*"  # the name contains characters of a glob pattern
    run = [sys.executable, "-c", KILLED, make.__name__, str(out)]
    assert subprocess.run(run).returncode == -9
    assert any("part-" in name and name.endswith("/half") for name in names(tmp_path))
    with make(out) as folder:
        (folder / "whole").write_text("whole")
    assert names(tmp_path) == ["a[b]*", "a[b]*/whole"]


@pytest.mark.parametrize("make", [new_folder, whole_folder])
def test_the_folder_of_another_active_run_is_not_deleted(tmp_path, make):
    with make(tmp_path / "out") as first:
        (first / "a").write_text("a")
        with pytest.raises(RuntimeError), make(tmp_path / "out"):
            raise RuntimeError
        assert (first / "a").exists()
    assert names(tmp_path) == ["out", "out/a"]


def test_the_first_of_two_runs_to_finish_writes_the_folder(tmp_path):
    with pytest.raises(GraycastError, match="out: cannot be written"):
        with new_folder(tmp_path / "out") as slow:
            (slow / "slow").write_text("slow")
            with new_folder(tmp_path / "out") as quick:
                (quick / "quick").write_text("quick")
    assert names(tmp_path) == ["out", "out/quick"]


KILLED_WRITING = """
import os, signal, sys
from pathlib import Path
from graycast.base.folder import claimed_folder, fill_whole
def half(file):
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
with claimed_folder(Path(sys.argv[1]), "inside", ".lock"):
    Path(sys.argv[2]).parent.mkdir(exist_ok=True)
    fill_whole(Path(sys.argv[2]), half)
"""


@pytest.mark.parametrize("file", ["table.md", "inside/claim.json", "inside/setting/000.json"])
def test_claiming_a_folder_deletes_half_written_files_of_a_killed_run(tmp_path, file):
    out = tmp_path / "out"
    run = [sys.executable, "-c", KILLED_WRITING, str(out), str(out / file)]
    assert subprocess.run(run).returncode == -9
    (left,) = [name for name in names(out) if "/.tmp-" in f"/{name}"]
    (out / "inside/kept.json").write_text("kept")
    before = {*names(out)}
    with claimed_folder(out, "inside", ".lock"):
        assert {*names(out)} == before - {left}
        (out / left).write_text("half of a file of the run that goes on")
        with pytest.raises(GraycastError, match="another run is writing"):
            with claimed_folder(out, "inside", ".lock"):
                pass
        assert {*names(out)} == before


def test_a_file_keeps_its_content_if_its_replacement_fails(tmp_path, monkeypatch):
    file = tmp_path / "figures.json"
    write_whole(file, b"old")
    write_whole(file, b"new")
    assert file.read_bytes() == b"new"
    with monkeypatch.context() as patch:
        patch.setattr("os.replace", refuse)
        with pytest.raises(GraycastError, match="no room"):
            write_whole(file, b"newer")
    assert file.read_bytes() == b"new" and names(tmp_path) == ["figures.json"]
    with pytest.raises(GraycastError, match="nowhere"):
        write_whole(tmp_path / "nowhere/figures.json", b"new")


def refuse(*paths):
    raise OSError("no room")


def test_a_replaced_file_or_folder_appears_complete_or_not_at_all(tmp_path):
    """A file replaces an earlier file; a folder replaces only an empty folder."""
    with beside(tmp_path / "scene") as folder:
        folder.mkdir()
        (folder / "a").write_text("a")
        assert not (tmp_path / "scene").exists()
    for error in (KeyError, KeyboardInterrupt):
        with pytest.raises(error), beside(tmp_path / "file") as file:
            file.write_text("half")
            raise error
        with pytest.raises(error), beside(tmp_path / "other") as folder:
            (folder / "deep").mkdir(parents=True)
            raise error
    with pytest.raises(OSError), beside(tmp_path / "scene") as folder:
        folder.mkdir()
        (folder / "b").write_text("b")
    assert names(tmp_path) == ["scene", "scene/a"]


def test_a_written_subfolder_replaces_an_earlier_subfolder(tmp_path):
    """The earlier folder stays until the new one is complete, and then disappears completely."""
    for picture in ("old", "new"):
        with whole_folder(tmp_path / "out") as folder:
            (folder / "pictures").mkdir()
            (folder / "pictures" / picture).write_text(picture)
    assert names(tmp_path) == ["out", "out/pictures", "out/pictures/new"]
    with pytest.raises(KeyError), whole_folder(tmp_path / "out") as folder:
        (folder / "pictures").mkdir()
        raise KeyError
    assert names(tmp_path) == ["out", "out/pictures", "out/pictures/new"]


HOLDER = """
import sys
from pathlib import Path
from graycast.base.folder import take_lock
lock = take_lock(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_lock_belongs_to_one_process_and_ends_with_the_process(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path / "lock")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with holder:
        assert holder.stdout.readline() == "held\n"
        assert take_lock(tmp_path / "lock") is None
        holder.kill()
    lock = take_lock(tmp_path / "lock")
    assert lock is not None and take_lock(tmp_path / "lock") is None
    lock.close()
