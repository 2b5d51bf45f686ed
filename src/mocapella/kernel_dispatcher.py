"""Compile kernels that only other kernels call as LLVM code alone.

A callee, a kernel that another kernel calls, is linked into the caller's LLVM module and optimised there again. Its own
machine code, wrapper for calls from Python and separate optimisation are then unused. Here a callee gets none of these
until Python calls it, which shortens the compilation of a tracker by a third.
"""

from __future__ import annotations

from typing import Any

from llvmlite import binding
from numba.core import compiler, dispatcher, sigutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack


def compiling() -> bool:
    """Whether this thread is compiling a kernel, so that a kernel requested now is a callee of that one."""
    return ConfigStack.top_or_none() is not None  # type: ignore[no-untyped-call]


class Callee:
    """Placeholder for the entry point of a kernel without machine code; numba finds the kernel's LLVM code by it."""


class KernelDispatcher(CPUDispatcher):
    """numba's dispatcher of one kernel, which generates machine code only for signatures that Python calls.

    An overload, the compilation for one signature, that only other kernels call has a `Callee` as its entry point. It
    is compiled again, with machine code, when Python calls it.

    Args:
        py_func: the Python function.
        targetoptions: numba's options of ``njit``.
    """

    def __init__(self, py_func: Any, targetoptions: dict[str, Any]) -> None:
        super().__init__(py_func, targetoptions=targetoptions)
        self._compiler = _KernelCompiler(py_func, self.targetdescr, targetoptions, {}, compiler.Compiler)

    def compile(self, sig: Any) -> Any:
        """Compile the overload of a signature unless it exists already, and return its entry point.

        ``sig`` is numba's signature or tuple of argument types. While another kernel is being compiled, the entry point
        may be a `Callee`; otherwise it is a function that Python can call.
        """
        with global_compiler_lock:
            args = tuple(sigutils.normalize_signature(sig)[0])  # type: ignore[no-untyped-call]
            compiled: Any = self.overloads.get(args)
            if compiled is not None and isinstance(compiled.entry_point, Callee) and not compiling():
                del self.overloads[args]
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        """Register a compilation result ``cres`` for other kernels; with machine code, also for calls from Python.

        Without machine code, Python's next call with this signature compiles it again; see `compile`.
        """
        if isinstance(cres.entry_point, Callee):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)


class _KernelCompiler(dispatcher._FunctionCompiler):  # type: ignore[misc,name-defined]
    def _compile_core(self, args: Any, return_type: Any) -> Any:
        is_callee = compiling()
        flags: Any = _Flags()  # type: ignore[no-untyped-call]
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        target = self.targetdescr.target_context
        library = (_CalleeLibrary if is_callee else _KernelLibrary)(target.codegen(), self.py_func.__qualname__)  # type: ignore[no-untyped-call]
        library.enable_object_caching()  # type: ignore[no-untyped-call]
        if is_callee:
            flags.no_cpython_wrapper = flags.no_compile = True
        compiled: Any = compiler.compile_extra(  # type: ignore[no-untyped-call]
            self.targetdescr.typing_context,
            target,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self.pipeline_class,
        )
        compiled = compiled._replace(type_annotation=None)  # a listing of all types, which only costs time and disk
        if not is_callee:
            for environment in compiled._find_referenced_environments():  # of callees, which have no machine code
                library.codegen.set_env(environment.env_name, environment)
            return compiled
        library._ensure_finalized()  # type: ignore[no-untyped-call]
        callee = Callee()
        target.insert_user_function(callee, compiled.fndesc, [library])
        return compiled._replace(entry_point=callee)


class _Flags(compiler.Flags):
    """numba compares and hashes its flags for each operator of a kernel; these do so without a copy of all options."""

    def __eq__(self, other: object) -> bool:
        if self is other or (isinstance(other, _Flags) and self._values == other._values):
            return True
        return bool(super().__eq__(other))  # type: ignore[no-untyped-call]

    def __hash__(self) -> int:
        return hash(frozenset(self._values))


class _KernelLibrary(JITCodeLibrary):
    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave functions to the optimisation of the whole module."""
        ll_module.data_layout = self._codegen._data_layout


class _CalleeLibrary(_KernelLibrary):
    def _finalize_final_module(self) -> None:
        """Generate no machine code."""
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        return self.serialize_using_bitcode()  # type: ignore[no-any-return,no-untyped-call]


def is_callee(serialized: tuple[Any, ...]) -> bool:
    """Whether ``serialized``, numba's tuple for a compilation in its cache, has LLVM code alone and no machine code."""
    return bool(serialized[0][1] == "bitcode")


def rebuild_callee(target: Any, serialized: tuple[Any, ...]) -> Any:
    """Return numba's compilation result of a callee that was read from the cache.

    Args:
        target: numba's target context.
        serialized: a tuple for which `is_callee` is True.
    """
    (name, _, bitcode), fndesc, environment, signature, _, lifted, annotation, reload_init, environments = serialized
    for initialise in reload_init:
        initialise()
    library = _CalleeLibrary(target.codegen(), name)  # type: ignore[no-untyped-call]
    library._final_module = binding.parse_bitcode(bitcode)
    library._finalize_final_module()
    return compiler.compile_result(  # type: ignore[no-untyped-call]
        target_context=target,
        typing_context=target.typing_context,
        library=library,
        environment=environment,
        entry_point=Callee(),
        fndesc=fndesc,
        type_annotation=annotation,
        signature=signature,
        objectmode=False,
        lifted=lifted,
        reload_init=reload_init,
        referenced_envs=environments,
    )
