"""Annotations of arrays with their axes, for modules that must also work without jaxtyping.

If jaxtyping is not installed, `Float[np.ndarray, "h w"]` means `np.ndarray`, and nothing is
checked. Modules that `graycast.dataset.training` does not import use jaxtyping directly.

Public attributes and functions use the types at the end, for example `FloatArray_h_w`. An editor
shows the name of such a type, with its dtype and axes. It shows jaxtyping's types as `ndarray`.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Type checkers must see jaxtyping's own names.
    from jaxtyping import Bool, Float, Float32, Int, Num, UInt8, UInt16
else:
    try:
        from jaxtyping import Bool, Float, Float32, Int, Num, UInt8, UInt16
    except ImportError:

        class _Unchecked:
            """Annotation of an array whose axes and type are not checked."""

            def __class_getitem__(cls, annotation: tuple[type, str]) -> type:
                return annotation[0]

        Bool = Float = Float32 = Int = Num = UInt8 = UInt16 = _Unchecked

__all__ = ["Bool", "Float", "Float32", "Int", "UInt8", "UInt16"]

BoolArray_bh_bw = Bool[np.ndarray, "bh bw"]
BoolArray_h_w = Bool[np.ndarray, "h w"]
BoolArray_n = Bool[np.ndarray, " n"]
BoolArray_n_h_w = Bool[np.ndarray, "n h w"]
Float32Array_h_w = Float32[np.ndarray, "h w"]
Float32Array_h_w_3 = Float32[np.ndarray, "h w 3"]
Float32Array_n_h_w_2 = Float32[np.ndarray, "n h w 2"]
Float32Array_n_4 = Float32[np.ndarray, "n 4"]
FloatArray_2_3 = Float[np.ndarray, "2 3"]
FloatArray_2_h_w = Float[np.ndarray, "2 h w"]
FloatArray_3 = Float[np.ndarray, "3"]
FloatArray_3_3 = Float[np.ndarray, "3 3"]
FloatArray_4_4 = Float[np.ndarray, "4 4"]
FloatArray_any = Float[np.ndarray, "*n"]
FloatArray_f = Float[np.ndarray, " f"]
FloatArray_f_3 = Float[np.ndarray, "f 3"]
FloatArray_f_3_2 = Float[np.ndarray, "f 3 2"]
FloatArray_f_3_3 = Float[np.ndarray, "f 3 3"]
FloatArray_h_w = Float[np.ndarray, "h w"]
FloatArray_h_w_3 = Float[np.ndarray, "h w 3"]
FloatArray_k_3 = Float[np.ndarray, "k 3"]
FloatArray_n = Float[np.ndarray, " n"]
FloatArray_n_3 = Float[np.ndarray, "n 3"]
FloatArray_n_4 = Float[np.ndarray, "n 4"]
FloatArray_n_4_4 = Float[np.ndarray, "n 4 4"]
FloatArray_n_h_w = Float[np.ndarray, "n h w"]
FloatArray_rows_columns = Float[np.ndarray, "rows columns"]
FloatArray_s_4_4 = Float[np.ndarray, "s 4 4"]
FloatArray_t_4_4 = Float[np.ndarray, "t 4 4"]
FloatArray_v_3 = Float[np.ndarray, "v 3"]
IntArray_f_3 = Int[np.ndarray, "f 3"]
IntArray_h_w = Int[np.ndarray, "h w"]
IntArray_n = Int[np.ndarray, " n"]
IntArray_n_2 = Int[np.ndarray, "n 2"]
NumArray_any = Num[np.ndarray, "*n"]
UInt8Array_any = UInt8[np.ndarray, "*n"]
UInt8Array_h_w = UInt8[np.ndarray, "h w"]
UInt8Array_h_w_3 = UInt8[np.ndarray, "h w 3"]
UInt8Array_n_3 = UInt8[np.ndarray, "n 3"]
UInt8Array_n_ph_pw = UInt8[np.ndarray, "n ph pw"]
UInt8Array_rows_columns = UInt8[np.ndarray, "rows columns"]
# This union has a name, because type checkers shorten a union of two array types to one of them.
UInt8or16Array_n_h_w = UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]
