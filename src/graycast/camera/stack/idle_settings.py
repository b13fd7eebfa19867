"""Detect settings that have no effect on a stack."""

from dataclasses import fields

from ...rig.pair import Rig
from ...rig.pattern import Code
from ..decode import DecodeSpec
from ..decode.plan import plan_axes
from .description import StackDescription

USUAL = DecodeSpec()
_NEEDS = {
    "doubt": "it needs Gray bits",
    "fine_bits": "it needs Gray bits of an axis without phases",
    "settling_votes": "it needs phases and Gray bits of one axis",
    "min_visibility": "it needs phases or lines",
    "max_epipolar_px": "it needs a rig and frames of both axes",
}


def idle_settings(
    spec: DecodeSpec, max_epipolar_px: float | None, code: Code, rig: Rig | None
) -> list[str]:
    """Return a note that names the stated settings without effect; empty if all have an effect.

    A setting counts as stated if it differs from its default, or if it switches a check on.

    Args:
        max_epipolar_px: the value in the stack file; None if it is not stated.
    """
    plans = plan_axes(code, spec.fine_bits).values()
    phases = any(plan.periods for plan in plans)
    bits = any(plan.bits for plan in plans)
    both = any(plan.periods and plan.bits for plan in plans)
    plain = any(plan.bits and not plan.periods for plan in plans)
    checked = rig is not None and len(code.axes) == 2
    limit_px = max_epipolar_px or 0.0
    facts = (
        ("doubt", spec.doubt, spec.doubt != USUAL.doubt, bits),
        ("fine_bits", spec.fine_bits, spec.fine_bits != USUAL.fine_bits, plain),
        ("settling_votes", spec.settling_votes, spec.settling_votes > 0, both),
        ("min_visibility", spec.min_visibility, spec.min_visibility > 0, phases),
        ("max_epipolar_px", limit_px, limit_px > 0, checked),
    )
    idle = [
        f"{name} {value:g} ({_NEEDS[name]})"
        for name, value, stated, used in facts
        if stated and not used
    ]
    if not idle:
        return []
    return [f"settings of decode that have no effect on this stack: {', '.join(idle)}"]


def unread_settings(description: StackDescription, rig_file: DecodeSpec) -> list[str]:
    """Return a note that names settings in the section `decode` of a rig file, which are not used.

    Only settings count that differ from the default and that the stack file does not state.
    """
    stated = description.decode.model_fields_set
    unread = [
        f"{field.name} {getattr(rig_file, field.name):g}"
        for field in fields(DecodeSpec)
        if field.name not in stated and getattr(rig_file, field.name) != getattr(USUAL, field.name)
    ]
    if not unread:
        return []
    return [
        f"settings of the rig that are not used, as a stack is read by its own file: "
        f"{', '.join(unread)}; state them in its section decode"
    ]
