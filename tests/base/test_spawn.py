"""Worker processes do not run the script that starts them; their results come in order."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest

from graycast.base.errors import WorkerDied
from graycast.base.spawn import in_order

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


@pytest.mark.slow
def test_results_come_in_the_order_of_the_items_from_several_processes():
    process_of = partial(eval, "__import__('os').getpid()")  # The item is the set of its names.
    processes = list(in_order(process_of, [{} for _ in range(8)], workers=2))
    assert len(processes) == 8 and os.getpid() not in processes
    assert list(in_order(abs, [-3, 1, -2, 0, -7, 5], workers=2)) == [3, 1, 2, 0, 7, 5]


@pytest.mark.slow
def test_several_processes_start_items_only_a_little_ahead_of_the_results(tmp_path):
    """The folder of each item shows that a process has started it."""
    started = in_order(os.mkdir, [tmp_path / f"{i}" for i in range(50)], workers=2)
    next(started)
    assert len(list(tmp_path.iterdir())) <= 6
    started.close()


@pytest.mark.slow
def test_ctrl_c_ends_all_processes_without_their_tracebacks():
    """A terminal sends Ctrl-C to all processes. Workers are idle, busy or in the start."""
    script = (
        "import time; from graycast.base.spawn import in_order\n"
        "try:\n"
        "    for _ in in_order(time.sleep, [0, 0.2, 0.2, 0.2], workers=2):\n"
        "        print('item', flush=True)\n"
        "except KeyboardInterrupt: print('stopped')\n"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", script], stdout=-1, stderr=-1, text=True, start_new_session=True
    )
    first = run.stdout.readline()
    os.killpg(run.pid, signal.SIGINT)
    out, error = run.communicate(timeout=60)
    assert (first, out.splitlines()[-1], error) == ("item\n", "stopped", "")


@pytest.mark.slow
def test_the_error_for_a_killed_process_says_what_to_change():
    kill = partial(eval, "__import__('os').kill(__import__('os').getpid(), 9)")
    with pytest.raises(WorkerDied, match=r"a worker process was killed.* fewer than 2 workers"):
        list(in_order(kill, [{}, {}], workers=2))
