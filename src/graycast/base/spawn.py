"""Processes that Python starts from scratch, because a JIT's threads do not survive a fork.

Python's `spawn` runs the user's script again in each process, so a script without the guard
`if __name__ == "__main__"` would end in an error. Our processes need nothing from the script,
because their functions and data come from modules.
"""

import sys
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any


class _Process(SpawnProcess):
    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return SpawnProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = script


class _Context(SpawnContext):
    Process = _Process


SPAWN = _Context()  # replaces `multiprocessing.get_context("spawn")`
