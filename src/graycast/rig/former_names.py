"""Names that scanners of the shelf had in earlier versions, and the names that they have now."""

import logging
import re
from functools import cache
from typing import Annotated

from pydantic import AfterValidator

# They were a maker's own names. They are understood until version 1.0.
FORMER_NAMES = {f"phoxi-{size}": f"like-phoxi-{size}" for size in "sml"}
_WORD = re.compile(rf"(?<![\w-])({'|'.join(FORMER_NAMES)})(?![\w-])")


@cache  # One process writes the note of a name once.
def current_name(name: str) -> str:
    """Return the name that a scanner has now; any other name comes back as it is.

    The log has one line for each former name that a process meets.
    """
    if name not in FORMER_NAMES:
        return name
    logging.getLogger(__name__).warning(
        "%s is now %s: change the name, which is understood until version 1.0",
        name,
        FORMER_NAMES[name],
    )
    return FORMER_NAMES[name]


RigName = Annotated[str, AfterValidator(current_name)]  # of a key that names a preset or a file


def with_current_names(text: str) -> str:
    """Return a stored text in which each former name is the current one, to compare two texts."""
    return _WORD.sub(lambda match: FORMER_NAMES[match[0]], text)
