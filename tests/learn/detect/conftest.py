"""Networks are tested in one thread, which is fastest while other processes run."""

import sys

import pytest


@pytest.fixture(autouse=True)
def one_thread_of_torch():
    """Flush denormals in these tests only, because SciPy's k-d tree does not end without them."""
    torch = sys.modules.get("torch")  # Tests of encodings need no torch.
    if torch is None:
        yield
        return
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    yield
    torch.set_flush_denormal(False)
