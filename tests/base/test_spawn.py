"""Worker processes do not run the script that starts them."""

import subprocess
import sys

import pytest

SCRIPT = """
import math
from concurrent.futures import ProcessPoolExecutor
from graycast.base.spawn import SPAWN

print("the script runs", flush=True)
process = SPAWN.Process(target=print, args=("a process",), kwargs={"flush": True})
process.start()
process.join()
with ProcessPoolExecutor(2, mp_context=SPAWN) as pool:
    print(list(pool.map(math.sqrt, (4, 9))))
print(sys.modules["__main__"].SCRIPT_IS_HERE)
"""


@pytest.mark.slow
def test_a_script_without_a_main_guard_runs_only_once(tmp_path):
    """Plain `spawn` fails: each process would start others before it is ready."""
    script = tmp_path / "script.py"
    script.write_text(f"import sys\nSCRIPT_IS_HERE = True\n{SCRIPT}")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    lines = ["the script runs", "a process", "[2.0, 3.0]", "True"]
    assert done.stdout.splitlines() == lines, done.stderr
