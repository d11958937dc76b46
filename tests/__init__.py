"""What tests and the quick forms of other checks share."""

import os
import threading
from typing import Any

from hystfit.config import set_compiler_flags

# Two thirds of the quick form's time is compilation, of programs that run for milliseconds: 22 % less without optimization, and a quarter
# less of the rest where a program is compiled by one thread, not in parts for several.
ONE_THREAD = "--xla_cpu_parallel_codegen_split_count=1"
# LLVM without optimization and with the widest vectors gave a Preisach inverse a wrong sign; optimized programs were right.
FAST_TO_COMPILE = f"--xla_backend_optimization_level=0 {ONE_THREAD} --xla_cpu_prefer_vector_width=256"
# Programs that are lowered in one context of MLIR, which keeps their types and constants until it is dropped.
PROGRAMS = 100


def compile_fast(flags: str = FAST_TO_COMPILE) -> None:
    """Compile for little processor time in this process, and with these flags in those it starts; call it before any computation.

    JAX makes a context of MLIR for each program, with all operations of all dialects, which took half of the lowering of a small one: with
    one for many files of tests took 5 to 12 % less processor time. That part of JAX is internal: where it is missing, nothing changes.
    """
    set_compiler_flags()
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"
    from jax._src.interpreters import mlir

    make = getattr(mlir, "make_ir_context", None)
    if make is None:
        return
    own = threading.local()

    def context() -> Any:
        if (
            mlir.ir.Context.current is not None
        ):  # a program that is needed while another one is lowered: not a part of that one
            return make()
        own.left = getattr(own, "left", 0) - 1
        if own.left < 0:
            own.left, own.context = PROGRAMS - 1, make()
        return own.context

    mlir.make_ir_context = context
