"""The renderers that the studies hold against each other."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from ..render import Renderer, open_renderer


@contextmanager
def opened(device: str, *patterns_per_render: int) -> Iterator[tuple[Renderer, ...]]:
    """Mitsuba, and a Cycles for each number of patterns per render, all on one device.

    Args:
        device: 'auto', 'cpu', 'cuda' or 'optix'; Mitsuba always uses OptiX on a GPU.

    Raises:
        DeviceError: the device, or Cycles, is not there.
    """
    with ExitStack() as stack:
        # Cycles first: where it is missing nothing needs to be waited for.
        cycles = [
            stack.enter_context(open_renderer("cycles", device=device, patterns_per_render=number))
            for number in patterns_per_render
        ]
        own = "cuda" if device == "optix" else device
        yield (stack.enter_context(open_renderer("mitsuba", device=own)), *cycles)
