"""What a terminal is told of a merge: a row a view, and the order in which they add most."""

from collections.abc import Iterator, Mapping
from typing import Any

_MOST_REASONS = 2


def described(surface: Mapping[str, Any]) -> Iterator[str]:
    """Lines about one of the `surfaces` of `merge.json`."""
    views = surface["views"]
    yield (
        f"of the parts' surface {_share(surface['visible'])} is visible to a camera, and of that "
        f"{_share(surface['measured'])} is measured by the views together:"
    )
    wide = max(len(view["view"]) for view in views)
    yield f"  {'view':{max(wide, 4)}}  measures  only it  others fill, and why it has none"
    for view in views:
        filled = view["filled_by_others"]
        why = sorted(filled.items(), key=lambda item: -item[1])[:_MOST_REASONS]
        reasons = ", ".join(f"{name.replace('_', ' ')} {_share(share)}" for name, share in why)
        yield (
            f"  {view['view']:{max(wide, 4)}}  {_share(view['measured']):>8}  "
            f"{_share(view['only_this_view']):>7}  {_share(sum(filled.values(), 0.0)):>6}"
            + (f" ({reasons})" if reasons else "")
        )
    if len(views) > 1:
        steps = [
            f"{step['view']} {'+' if k else ''}{_share(step['adds'])}"
            for k, step in enumerate(surface["best_order"])
        ]
        yield f"the order in which they add most: {', '.join(steps)}"


def _share(share: float) -> str:
    return f"{100 * share:.1f} %"
