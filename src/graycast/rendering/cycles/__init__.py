"""The back end Blender Cycles, which renders each projected pattern separately.

Cycles has its own Python environment (`make cycles`) and runs in a child process. The modules here
run in Graycast's process (`renderer.CyclesRenderer`); the modules of `worker/` run in the child.
"""

from .process import CyclesState, examine_cycles

__all__ = ["CyclesState", "examine_cycles"]
