"""A hint to the processor, for compiled loops that will soon look at places all over a large array."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

BYTES, WORD = ir.IntType(8).as_pointer(), ir.IntType(32)
READ, KEEP_CLOSE, DATA = 0, 3, 1  # LLVM's words: what for, how near to the core, and that it is no code


def _prefetch(typing_context, array, index):
    """Ask for the cache line where an item of an array ``[N]`` begins; an index outside the array does no harm."""

    def generate(context, builder, signature, arguments):
        values, place = arguments
        data = context.make_array(signature.args[0])(context, builder, values).data
        address = builder.bitcast(builder.gep(data, [place]), BYTES)
        hint = [ir.Constant(WORD, word) for word in (READ, KEEP_CLOSE, DATA)]
        kind = ir.FunctionType(ir.VoidType(), [BYTES, *[WORD] * len(hint)])
        function = builder.module.globals.get("llvm.prefetch") or ir.Function(builder.module, kind, "llvm.prefetch")
        builder.call(function, [address, *hint])
        return context.get_dummy_value()

    return types.void(array, index), generate


prefetch: Any = intrinsic(_prefetch)
