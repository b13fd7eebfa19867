"""Former faults of environment maps."""

import subprocess
import sys

import pytest

READ_ON_ONE_THREAD = """
import sys
from pathlib import Path
import numpy as np
from graycast.rendering import open_renderer
renderer = open_renderer("mitsuba", device="cpu", threads=2)
import drjit, mitsuba
file = Path(sys.argv[1])
mitsuba.Bitmap(np.ones((64, 128, 3), dtype=np.float32)).write(str(file))
drjit.set_thread_count(1)
from graycast.rendering.mitsuba.scene import _map_pixels
assert _map_pixels(file).shape == (64, 128, 3)
assert drjit.thread_count() == 1
"""


@pytest.mark.slow
def test_a_renderer_with_one_thread_reads_a_map_without_a_deadlock(tmp_path):
    """Two workers on two cores have one thread each, and waited for ever."""
    command = [sys.executable, "-c", READ_ON_ONE_THREAD, str(tmp_path / "map.exr")]
    subprocess.run(command, check=True, timeout=120)
