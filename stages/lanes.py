"""Four numbers side by side in a register of the processor, for compiled loops.

A pixel's colours are added up all at once, which the compiler would not think of by itself. Each
lane is worked out as a single float32 would be: no result depends on the machine.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.extending import models, register_model

intrinsic: Any = extending.intrinsic  # its types count an argument that only the compiler gives

COUNT = 4
_FOUR = ir.VectorType(ir.FloatType(), COUNT)
_INDEX = ir.IntType(32)


class _Lanes(types.Type):
    def __init__(self):
        super().__init__(name="Lanes")


@register_model(_Lanes)
class _Register(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _FOUR)


_lanes = _Lanes()


def _pointer(context, builder, kind, array, at):
    """To four numbers of a contiguous float32 array, from its `at`-th number on."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), _FOUR.as_pointer())


def _spread(builder, number):
    """A number in all lanes."""
    nothing = ir.Constant(_FOUR, ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(_INDEX, 0))
    zeros = ir.Constant(ir.VectorType(_INDEX, COUNT), [0] * COUNT)
    return builder.shuffle_vector(one, nothing, zeros)


@intrinsic
def none(_):
    """Four zeros."""

    def code(context, builder, signature, arguments):
        return ir.Constant(_FOUR, [0.0] * COUNT)

    return _lanes(), code


@intrinsic
def plus_part(_, total, array, at, weight):
    """total + weight array[at:at + 4]."""

    def code(context, builder, signature, arguments):
        total, array, at, weight = arguments
        four = builder.load(_pointer(context, builder, signature.args[1], array, at), align=4)
        return builder.fadd(total, builder.fmul(_spread(builder, weight), four))

    return _lanes(total, array, at, weight), code


@intrinsic
def plus_mean(_, total, array, above, below, step, a, b, c, d):
    """total + (a above + b its right neighbour) + (c below + d its right neighbour).

    above, below  where in the array four numbers begin, and `step` further their neighbours
    """

    def code(context, builder, signature, arguments):
        total, array, above, below, step, *weights = arguments
        places = above, builder.add(above, step), below, builder.add(below, step)
        a, b, c, d = (
            builder.fmul(
                _spread(builder, weight),
                builder.load(_pointer(context, builder, signature.args[1], array, place), align=4),
            )
            for place, weight in zip(places, weights, strict=True)
        )
        mean = builder.fadd(builder.fadd(a, b), builder.fadd(c, d))
        return builder.fadd(total, mean)

    return _lanes(total, array, above, below, step, a, b, c, d), code


@intrinsic
def add_to(_, sums, at, total, last):
    """sums[at:at + 4] += the total, with `last` in place of its last number; sums are float64."""

    def code(context, builder, signature, arguments):
        sums, at, total, last = arguments
        wide = ir.VectorType(ir.DoubleType(), COUNT)
        data = context.make_array(signature.args[0])(context, builder, sums).data
        place = builder.bitcast(builder.gep(data, [at]), wide.as_pointer())
        total = builder.insert_element(total, last, ir.Constant(_INDEX, COUNT - 1))
        total = builder.fadd(builder.load(place, align=8), builder.fpext(total, wide))
        builder.store(total, place, align=8)
        return context.get_dummy_value()

    return types.void(sums, at, total, last), code


@intrinsic
def number(_, array, at):
    """array.flat[at] of a contiguous float32 array, at >= 0."""

    def code(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.load(builder.gep(data, [arguments[1]]))

    return types.float32(array, at), code


@intrinsic
def fetch(_, array, at):
    """Asks for array.flat[at], wherever that may be, to be at hand soon."""

    def code(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(8).as_pointer())
        three = [ir.IntType(32)] * 3
        prefetch = builder.module.declare_intrinsic(
            "llvm.prefetch", [place.type], ir.FunctionType(ir.VoidType(), [place.type, *three])
        )
        builder.call(prefetch, [place, *(ir.Constant(_INDEX, k) for k in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, at), code
