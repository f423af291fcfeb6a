"""Numba's cache of machine code, read without numba's compiler.

Numba prepares its whole compiler before it reads a kernel from disk: types, operators, scipy.linalg. That takes more
time than a search on 1,000 rows (measured: benchmarks/speed.py). Kernels that are on disk need none of it. A kernel
that is not there is compiled as usual, because the compiler prepares itself once more.
"""

from __future__ import annotations

import functools
import pickle
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from llvmlite.binding import add_symbol, parse_assembly, parse_bitcode
from numba.core import environment
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.entrypoints import init_all
from numba.core.runtime import _nrt_python

from . import ahead
from .turn import Turn


class _Results(CompileResultCacheImpl):  # type: ignore[misc]
    """Compiled kernels; the intermediate code beside the machine code is parsed where another kernel inlines it."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        (name, kind, data), described, *others = payload
        if kind != "object":
            return super().rebuild(target_context, payload)
        machine_code, bitcode = data
        codegen = target_context.codegen()
        codegen._engine._defined_symbols |= {described.llvm_func_name, described.llvm_cpython_wrapper_name,
                                             described.llvm_cfunc_wrapper_name}
        found = super().rebuild(target_context, ((name, kind, (machine_code, _empty())), described, *others))
        found.library._bitcode = bitcode
        found.library.__class__ = _Library
        return found


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """Code of one kernel whose intermediate code is parsed on demand."""

    _bitcode: bytes | None = None

    def _get_module_for_linking(self) -> Any:
        if self._bitcode is not None:
            self._shared_module, self._bitcode = parse_bitcode(self._bitcode), None
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()


@functools.cache
def _name_memory() -> None:
    """Name the functions by which machine code allocates arrays; the compiler also compiles parts of them."""
    for name, address in _nrt_python.c_helpers.items():
        add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@functools.cache
def _empty() -> bytes:
    return parse_assembly("").as_bitcode()  # type: ignore[no-any-return]


class Kept(FunctionCache):  # type: ignore[misc]
    """Numba's cache of one kernel; a kernel that is there loads without the compiler."""

    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file.__class__ = _Files
        self._turn = Turn()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for a signature, None where it is to be compiled.

        Of several processes that lack a kernel one compiles it, and the others wait for it.
        """
        _name_memory()
        found = self._found(sig, target_context)
        if found is not None:
            return found
        ahead.begin(self._py_func, sig)
        self._turn.take(self._cache_file._index_path)
        found = self._found(sig, target_context)
        if found is not None:
            self._turn.give()
        else:
            init_all()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write a kernel that was compiled, and let other processes have it."""
        try:
            super().save_overload(sig, data)
        finally:
            self._turn.give()

    def _found(self, sig: Any, target_context: Any) -> Any:
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)
        return None

    def holds(self, sig: Any, target_context: Any) -> bool:
        """True where the kernel for a signature is on disk, or another process compiles it; nothing is loaded."""
        if self._turn.taken(self._cache_file._index_path):
            return True
        name = self._cache_file._load_index().get(self._index_key(sig, target_context.codegen()))
        return name is not None and Path(self._cache_file._data_path(name)).exists()


class _Files(IndexDataCacheFile):  # type: ignore[misc]
    """Files of one kernel, read by an unpickler that imports none of numba's implementations."""

    def _load_data(self, name: str) -> Any:
        return _Unpickler(BytesIO(Path(self._data_path(name)).read_bytes())).load()


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numba.core.environment", "_rebuild_env"):
            return _environment
        return super().find_class(module, name)


def _environment(module: str, constants: Any, name: str) -> Any:
    """The globals of a compiled function; those of numba's own functions, which no kernel reads, stay empty.

    Numba would import the module of each of its functions that was compiled into a kernel.
    """
    if not module.startswith("numba.") or module in sys.modules:
        return environment._rebuild_env(module, constants, name)
    made = environment.Environment({})
    made.consts[:] = constants
    made.env_name = name
    return made
