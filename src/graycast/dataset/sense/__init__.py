"""Whether what a scene's files say can be true together: checks of sense, which need no checksum.

Each file alone may be whole and still wrong. Pictures show the edges of what lies there, light and
reasons obey the decoder's rules, the scanner errs to both sides, parts stand on a floor, and a
manifest tells of its own files. Thresholds lie between what sound datasets show
(docs/reference/validate.md has them) and what a fault makes of them;
where physics does not tell, nothing is said.
"""

from collections.abc import Iterator

from .evidence import Evidence
from .floor_and_walls import world_problems
from .light import light_problems
from .manifest import manifest_problems
from .picture_edges import picture_problems
from .scanner_depth import scanner_problems

__all__ = ["Evidence", "sense_problems"]


def sense_problems(scene: Evidence) -> Iterator[str]:
    """All that cannot be true of one scene whose files are whole."""
    yield from manifest_problems(scene)
    yield from scanner_problems(scene)
    yield from light_problems(scene)
    yield from picture_problems(scene)
    yield from world_problems(scene)
