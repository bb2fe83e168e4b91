"""The binder of the compiled kernels: what does not fit its C signature is refused in one sentence, before C sees it."""

import ctypes

import numpy as np
import pytest
import torch

from f4x_core.errors import F4xError
from f4x_core.native import open_library
from f4x_core.native.appearance import APPEARANCE
from f4x_core.native.binder import DOUBLE, FLOAT, INT32, INT64, Array, Function, Result, Struct
from f4x_core.native.picture import F4X_PICTURE_LOSS, PICTURE
from f4x_core.raster.native.library import GRADIENTS, PROBLEM
from f4x_core.scaffold.deformation.native.library import DEFORMATION, RELATIONS

POINTS = Struct(
    "Points",
    {
        "count": INT64,
        "times": INT32,
        "scale": FLOAT,
        "centre": FLOAT * 3,
        "places": Array("float32", ("count", 3)),
        "mask": Array("bool", ("count",), optional=True),
        "pixels": Array("float32", ("count", 2), optional=True, strides=("pitch", 1)),
        "moved": Array("float32", ("1+times", "count", 3), optional=True, output=True),
    },
    sizes=("pitch",),
)


def values(**changed):
    """What fits: two Gaussians at three times."""
    fitting = {"count": 2, "times": 3, "pitch": 5, "scale": 0.5, "centre": (1, 2, 3)}
    return fitting | {"places": np.zeros((2, 3), np.float32)} | changed


def read_only(*shape):
    array = np.zeros(shape, np.float32)
    array.flags.writeable = False
    return array


def as_is(array):
    return array


KINDS = pytest.mark.parametrize("make", [as_is, torch.from_numpy], ids=["numpy", "torch"])


@KINDS
def test_a_struct_holds_numbers_and_addresses(make):
    places, moved = np.arange(6, dtype=np.float32).reshape(2, 3), np.zeros((4, 2, 3), np.float32)
    filled = POINTS(**values(places=make(places), moved=make(moved)))
    assert (filled.count, filled.times, filled.scale, list(filled.centre)) == (2, 3, 0.5, [1, 2, 3])
    assert (filled.places, filled.moved) == (places.ctypes.data, moved.ctypes.data)
    assert filled.mask is None and filled.pixels is None


def test_a_struct_keeps_its_arrays_alive():
    filled = POINTS(**values(places=np.full((2, 3), 7, np.float32)))
    np.zeros((2, 3), np.float32)  # would take the freed memory
    assert list((ctypes.c_float * 6).from_address(filled.places)) == [7] * 6


@KINDS
def test_empty_arrays_pass(make):
    POINTS(**values(count=0, places=make(np.zeros((0, 3), np.float32))))
    across = make(np.zeros((2, 0), np.float32)).T  # of no entries it does not matter how they would lie
    POINTS(**values(count=0, places=make(np.zeros((0, 3), np.float32)), pixels=across))


def test_inputs_may_be_read_only():
    places = read_only(2, 3)
    assert POINTS(**values(places=places)).places == places.ctypes.data


@KINDS
def test_declared_strides_pass(make):
    wide = np.zeros((2, 5), np.float32)
    assert POINTS(**values(pixels=make(wide)[:, :2])).pixels == wide.ctypes.data


@pytest.mark.parametrize("dtype", ["float64", "int32", "float16"])
@KINDS
def test_wrong_dtype(make, dtype):
    POINTS(**values(places=make(np.zeros((2, 3), np.float32))))  # the right one just before changes nothing
    with pytest.raises(F4xError, match=rf"^Points\.places has to be float32, not {dtype}\.$"):
        POINTS(**values(places=make(np.zeros((2, 3), dtype))))


def test_other_byte_order():
    with pytest.raises(F4xError, match=r"^Points\.places has to be float32, not >f4\.$"):
        POINTS(**values(places=np.zeros((2, 3), ">f4")))


@KINDS
def test_not_contiguous(make):
    with pytest.raises(F4xError, match=r"^Points\.places has to be C-contiguous in memory\.$"):
        POINTS(**values(places=make(np.zeros((3, 2), np.float32)).T))
    with pytest.raises(F4xError, match=r"^Points\.pixels has to be laid out with the strides \(5, 1\) in memory\.$"):
        POINTS(**values(pixels=make(np.zeros((2, 2), np.float32))))


@KINDS
def test_wrong_shape(make):
    sentence = r"^Points\.places has to have the shape \(count, 3\) = \(2, 3\), not \(2, 4\)\.$"
    with pytest.raises(F4xError, match=sentence):
        POINTS(**values(places=make(np.zeros((2, 4), np.float32))))
    with pytest.raises(F4xError, match=r"^Points\.mask has to have the shape \(count,\) = \(2,\), not \(2, 1\)\.$"):
        POINTS(**values(mask=make(np.zeros((2, 1), bool))))
    sentence = r"^Points\.moved has to have the shape \(1\+times, count, 3\) = \(4, 2, 3\), not \(3, 2, 3\)\.$"
    with pytest.raises(F4xError, match=sentence):
        POINTS(**values(moved=make(np.zeros((3, 2, 3), np.float32))))


def test_outputs_that_are_read_only():
    with pytest.raises(F4xError, match=r"^Points\.moved is written by the kernel, but the array is read-only\.$"):
        POINTS(**values(moved=read_only(4, 2, 3)))


def test_not_on_the_cpu():
    with pytest.raises(F4xError, match=r"^Points\.places has to lie in the memory of the CPU, not on meta\.$"):
        POINTS(**values(places=torch.empty(2, 3, device="meta")))


@pytest.mark.parametrize("value, kind", [([[0, 0, 0]] * 2, "list"), (1.0, "float")])
def test_not_an_array(value, kind):
    with pytest.raises(F4xError, match=rf"^Points\.places has to be a numpy array or a torch tensor, not {kind}\.$"):
        POINTS(**values(places=value))


@pytest.mark.parametrize("name", ["count", "pitch", "scale", "places"])
def test_a_missing_value(name):
    rest = {key: value for key, value in values().items() if key != name}
    with pytest.raises(F4xError, match=rf"^Points needs {name}\.$"):
        POINTS(**rest)


def test_none_only_where_the_kernel_takes_it():
    with pytest.raises(F4xError, match=r"^Points needs places\.$"):
        POINTS(**values(places=None))


def test_an_unknown_field():
    with pytest.raises(F4xError, match=r"^Points has no field place\.$"):
        POINTS(**values(place=1))


def test_plain_copies_only_what_differs():
    fits, strided = np.zeros((2, 3), np.float32), np.zeros((2, 6))[:, ::2]
    assert POINTS.plain({"places": fits, "mask": None}, "places", "mask") == {"places": fits}
    plain = POINTS.plain({"places": strided}, "places", "mask")["places"]
    assert plain.dtype == np.float32 and plain.flags.c_contiguous


@pytest.mark.parametrize("given", [(), (1,), (1, 2, 3)])
def test_wrong_count_of_arguments(given):
    with pytest.raises(F4xError, match=rf"^f4x_picture_loss takes 2 arguments \(problem, total\), not {len(given)}\.$"):
        F4X_PICTURE_LOSS(*given)


@pytest.mark.skipif(open_library()[0] is None, reason="no compiled kernels")
def test_wrong_kind_of_argument():
    with pytest.raises(F4xError, match=r"^f4x_picture_loss does not take these values: argument 1: .*Points.*\.$"):
        F4X_PICTURE_LOSS(POINTS(**values()), DOUBLE())


def test_arrays_of_a_function_are_checked():
    function = Function("f4x_fill", {"image": Array("float32", ("height", 3), output=True), "failed": Result(INT32)})
    with pytest.raises(
        F4xError, match=r"^f4x_fill\.image has to have the shape \(height, 3\) = \(4, 3\), not \(5, 3\)\.$"
    ):
        function(np.zeros((5, 3), np.float32), INT32(), sizes={"height": 4})


@pytest.mark.parametrize(
    "struct", [PICTURE, APPEARANCE, PROBLEM, GRADIENTS, DEFORMATION, RELATIONS], ids=lambda s: s.name
)
def test_every_array_of_the_kernels_names_known_sizes(struct):
    known = {*struct.fields, *struct.sizes}
    assert {name for kind in struct.arrays.values() for name in kind.names()} <= known
