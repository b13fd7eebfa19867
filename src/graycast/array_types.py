"""What annotates arrays with their axes, where reading for training may do without jaxtyping.

Where jaxtyping is not installed, `Float[np.ndarray, "h w"]` says `np.ndarray` and no more: nothing
is checked then, and nothing else changes. Modules that `graycast.training` does not import take
the names from jaxtyping itself.
"""

try:
    from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16
except ImportError:

    class _Unchecked:
        """Annotates an array, and forgets what it holds."""

        def __class_getitem__(cls, told: tuple[type, str]) -> type:
            return told[0]

    Bool = Float = Float32 = Int = UInt8 = UInt16 = _Unchecked

__all__ = ["Bool", "Float", "Float32", "Int", "UInt8", "UInt16"]
