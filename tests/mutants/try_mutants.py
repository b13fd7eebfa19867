"""Put known bugs into a copy of the source, one after the other, and see which tests notice.

    .venv/bin/python tests/mutants/try_mutants.py                 all of mutants.txt
    .venv/bin/python tests/mutants/try_mutants.py digest boxes    those that have one of these words
    .venv/bin/python tests/mutants/try_mutants.py --all-tests     asks all quick tests of survivors

A bug that no test notices survives; it is named at the end, and the program ends with 1. The
working tree itself is never changed. Run it by hand: a bug takes as long as the tests beside it.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from graycast.base.kernels import kernel_folder

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.txt")
KERNELS = "kernels"  # The copy keeps its compiled kernels in this folder.


@dataclass(frozen=True, slots=True)
class Bug:
    """`text` occurs once in `src/graycast/FILE`; `tests` are arguments of pytest under `tests/`."""

    bug: str
    file: str
    text: str
    replaced_by: str
    tests: str


def planted() -> list[Bug]:
    """Return the bugs of `mutants.txt`, whose head describes the format."""
    bugs = []
    for paragraph in LIST.read_text(encoding="utf-8").split("\n\n"):
        lines = [line for line in paragraph.splitlines() if not line.startswith("#")]
        if lines:
            file, _, tests = lines[1].partition(": ")
            gone, come = ([line[2:] for line in lines[2:] if line[0] == sign] for sign in "-+")
            end = "" if come else "\n"
            text, other = "\n".join(gone) + end, "\n".join(come)
            bugs.append(Bug(bug=lines[0], file=file, text=text, replaced_by=other, tests=tests))
    return bugs


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("words", nargs="*", help="only bugs whose name or file has one of these")
    parser.add_argument("--all-tests", action="store_true", help="ask all quick tests of survivors")
    options = parser.parse_args()
    bugs = [
        bug
        for bug in planted()
        if not options.words or any(word in f"{bug.bug} {bug.file}" for word in options.words)
    ]
    with tempfile.TemporaryDirectory(prefix="graycast-mutants-") as folder:
        copy = Path(folder)
        copy_tree(copy)
        print(f"{len(bugs)} bugs; first their quick tests without any bug", flush=True)
        tests = sorted({test for bug in bugs for test in bug.tests.split()})
        if tests and (failed := failing_test(copy, tests)) is not None:
            sys.exit(f"the tests fail without any bug: {failed}")
        survivors = [bug for bug in bugs if not noticed(copy, bug, all_tests=options.all_tests)]
    print(f"{len(bugs) - len(survivors)} of {len(bugs)} bugs are noticed")
    for bug in survivors:
        print(f"  not noticed: {bug.bug} ({bug.file})")
    return 1 if survivors else 0


def copy_tree(copy: Path) -> None:
    """Copy what git knows or would add, as it is in the working tree, and the compiled kernels."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.check_output(command, cwd=ROOT, text=True).split("\0")
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    kernels = kernel_folder()  # Compiling all of them takes minutes.
    if kernels is not None and kernels.is_dir():
        shutil.copytree(kernels, copy / KERNELS)


def noticed(copy: Path, bug: Bug, *, all_tests: bool) -> bool:
    """Break the copy, run the tests, mend the copy; return whether a test failed."""
    path = copy / "src/graycast" / bug.file
    sound, times = path.read_text(encoding="utf-8"), path.stat()
    if sound.count(bug.text) != 1:
        sys.exit(f"{bug.file} has {sound.count(bug.text)} times {bug.text!r}: mend mutants.txt")
    broken = sound.replace(bug.text, bug.replaced_by)
    compile(broken, bug.file, "exec")
    path.write_text(broken, encoding="utf-8")
    start = time.monotonic()
    try:
        failed = failing_test(copy, bug.tests.split())
        slow = failing_test(copy, bug.tests.split(), slow=True) if failed is None else None
        if failed is None and slow is None and all_tests:
            failed = failing_test(copy, [""])
    finally:
        path.write_text(sound, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    if slow is not None and failing_test(copy, [slow.removeprefix("tests/")], slow=True):
        sys.exit(f"the test fails without any bug: {slow}")
    failed = failed or slow
    seconds = time.monotonic() - start
    print(f"{'noticed ' if failed else 'SURVIVES'} {seconds:4.0f} s  {bug.bug}", flush=True)
    print(f"                   {failed or bug.tests}", flush=True)
    return failed is not None


def failing_test(copy: Path, tests: list[str], *, slow: bool = False) -> str | None:
    """Return the first of the quick, or of the slow, tests that fails; None if all pass."""
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-rfE", "--tb=no", "-p", "no:cacheprovider"]
        + (["-m", "slow and not gpu"] if slow else [])
        + [str(Path("tests", test)) for test in tests],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy / "src"), "NUMBA_CACHE_DIR": str(copy / KERNELS)},
        capture_output=True,
        text=True,
    )
    if run.returncode in (0, 5):  # 5 means that all tests are slow.
        return None
    match = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
    if run.returncode > 2 or match is None:
        sys.exit(f"pytest ended with {run.returncode}: {run.stdout[-2000:]}{run.stderr[-2000:]}")
    return match[1]


if __name__ == "__main__":
    sys.exit(main())
