"""Current names of scanners that had another name in an earlier version."""

import logging
import re
from functools import cache
from typing import Annotated

from pydantic import AfterValidator

# The former names are product names of a maker. They are accepted until version 1.0.
FORMER_NAMES = {f"phoxi-{size}": f"like-phoxi-{size}" for size in "sml"}
_WORD = re.compile(rf"(?<![\w-])({'|'.join(FORMER_NAMES)})(?![\w-])")


@cache  # A process logs the note about a name only once.
def current_name(name: str) -> str:
    """Return the current name of a scanner; any other name is returned unchanged.

    A process logs one line for each former name.
    """
    if name not in FORMER_NAMES:
        return name
    logging.getLogger(__name__).warning(
        "%s is now %s: change the name, which is understood until version 1.0",
        name,
        FORMER_NAMES[name],
    )
    return FORMER_NAMES[name]


RigName = Annotated[str, AfterValidator(current_name)]  # for keys that name a preset or a file


def with_current_names(text: str) -> str:
    """Replace each former name in a stored text by the current one, to compare texts."""
    return _WORD.sub(lambda match: FORMER_NAMES[match[0]], text)
