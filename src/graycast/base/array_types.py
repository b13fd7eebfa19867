"""Annotations of arrays with their axes, for modules that must also work without jaxtyping.

If jaxtyping is not installed, `Float[np.ndarray, "h w"]` means `np.ndarray`, and nothing is
checked. Modules that `graycast.dataset.training` does not import use jaxtyping directly.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # Type checkers must see jaxtyping's own names.
    from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16
else:
    try:
        from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16
    except ImportError:

        class _Unchecked:
            """Annotation of an array whose axes and type are not checked."""

            def __class_getitem__(cls, annotation: tuple[type, str]) -> type:
                return annotation[0]

        Bool = Float = Float32 = Int = UInt8 = UInt16 = _Unchecked

__all__ = ["Bool", "Float", "Float32", "Int", "UInt8", "UInt16"]
