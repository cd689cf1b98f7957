"""Pickles that would do harm if they were loaded as pickles usually are: each leaves a file as its trace."""

from __future__ import annotations

import functools
import os
import pickle
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

Harm = Callable[[str], bytes]
"""Makes a pickle that writes the file of that name if it succeeds."""


class Calls:
    """An object whose pickle calls `function`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.reduced = function, arguments

    def __reduce__(self) -> Any:
        return self.reduced


def text(value: str) -> bytes:
    data = value.encode()
    return b"X" + struct.pack("<I", len(data)) + data


def stack_global(module: str, name: str) -> bytes:
    return text(module) + text(name) + b"\x93"


def program(trace: str) -> str:
    return f"open({trace!r}, 'w').close()"


def call(function: bytes, *arguments: bytes) -> bytes:
    """A call of what `function` pushes, in protocol 4, as the value of a dictionary's key."""
    return b"\x80\x04}" + text("env_params_train") + function + b"(" + b"".join(arguments) + b"tRs."


def history_with(value: Any, protocol: int = 4) -> bytes:
    return pickle.dumps({"env_params_train": value}, protocol=protocol)


def shell(trace: str) -> bytes:
    return history_with(Calls(os.system, f"touch {trace}"))


def shell_of_protocol_0(trace: str) -> bytes:
    return f"cos\nsystem\n(S'touch {trace}'\ntR.".encode()


def instance_of_protocol_0(trace: str) -> bytes:
    return f"(S'touch {trace}'\nios\nsystem\n.".encode()


def evaluation(trace: str) -> bytes:
    return history_with(Calls(eval, program(trace)))


def execution(trace: str) -> bytes:
    return history_with(Calls(exec, program(trace)))


def execution_of_python_2(trace: str) -> bytes:
    return f"c__builtin__\neval\n(S{program(trace)!r}\ntR.".encode()


def attribute(trace: str) -> bytes:
    return call(stack_global("builtins", "getattr"), stack_global("os", "path"), text("os"))


def partial(trace: str) -> bytes:
    return history_with(Calls(functools.partial(exec, program(trace))))


def mapping(trace: str) -> bytes:
    return history_with(list_of_map(trace))


def list_of_map(trace: str) -> Any:
    return Calls(list, Calls(map, exec, [program(trace)]))


def dotted_builtin(trace: str) -> bytes:
    return call(stack_global("builtins", "set.__class__.__base__"), text(trace))


def dotted_globals(trace: str) -> bytes:
    return call(stack_global("numpy._core.multiarray", "_reconstruct.__globals__"), text(trace))


def dotted_alias(trace: str) -> bytes:
    return call(stack_global("numpy", "f2py.os.system"), text(f"touch {trace}"))


def dotted_module(trace: str) -> bytes:
    return call(stack_global("numpy.core.multiarray.os", "system"), text(f"touch {trace}"))


def numpy_load(trace: str) -> bytes:
    np.save(f"{trace}.npy", np.array([Calls(os.system, f"touch {trace}")], dtype=object))
    return call(stack_global("numpy", "load"), text(f"{trace}.npy"), b"N", b"\x88")


def numpy_tester(trace: str) -> bytes:
    return call(stack_global("numpy.testing._private.utils", "runstring"), text(program(trace)), b"}")


def numpy_compiler(trace: str) -> bytes:
    return call(stack_global("numpy.f2py", "compile"), text(trace))


def numpy_member(trace: str) -> bytes:
    return call(stack_global("numpy._core.multiarray", "fromfile"), text(trace))


def numpy_writer(trace: str) -> bytes:
    return history_with(Calls(np.savetxt, trace, [1.0]))


def copy_reconstructor(trace: str) -> bytes:
    return call(
        stack_global("copyreg", "_reconstructor"),
        stack_global("builtins", "object"),
        stack_global("builtins", "object"),
        b"N",
    )


def torch_storage(trace: str) -> bytes:
    return call(stack_global("torch._utils", "_rebuild_tensor_v2"), text(trace))


def torch_load(trace: str) -> bytes:
    return call(stack_global("torch.storage", "_load_from_bytes"), text(trace))


def pandas_frame(trace: str) -> bytes:
    return call(stack_global("pandas.core.internals.managers", "BlockManager"), text(trace))


def object_array(trace: str) -> bytes:
    return history_with(np.array([Calls(os.system, f"touch {trace}")], dtype=object))


def plain_object_array(_: str) -> bytes:
    return history_with(np.array([{"a": 1}, None], dtype=object))


def record_array(_: str) -> bytes:
    return history_with(np.zeros(2, dtype=[("a", "O"), ("b", "f8")]))


def new_instance(trace: str) -> bytes:
    """NEWOBJ: makes an instance without calling anything."""
    return b"\x80\x02}" + text("a") + b"cpathlib\nPosixPath\n(" + text(trace) + b"t\x81s."


def new_instance_of_granted(_: str) -> bytes:
    return b"\x80\x02}" + text("a") + b"c__builtin__\nset\n)\x81s."


def state_of_granted(trace: str) -> bytes:
    """BUILD with slots: would change what the name stands for in this process."""
    state = b"N}" + text("_make") + stack_global("os", "system") + b"s\x86"
    return b"\x80\x04}" + text("a") + stack_global("builtins", "set") + state + b"bs."


def plain_state_of_granted(_: str) -> bytes:
    state = b"N}" + text("_make") + text("x") + b"s\x86"
    return b"\x80\x04}" + text("a") + stack_global("numpy", "dtype") + state + b"bs."


def state_of_array(_: str) -> bytes:
    """An array whose state is a dictionary instead of numpy's tuple."""
    array = stack_global("numpy", "ndarray") + b"K\x00\x85" + b"C\x01b"
    begun = stack_global("numpy._core.multiarray", "_reconstruct") + array + b"\x87R"
    return b"\x80\x04}" + text("a") + begun + b"}" + text("__class__") + text("x") + b"sbs."


def shape_beyond_content(_: str) -> bytes:
    array = stack_global("numpy", "ndarray") + b"K\x00\x85" + b"C\x01b"
    begun = stack_global("numpy._core.multiarray", "_reconstruct") + array + b"\x87R"
    kind = stack_global("numpy", "dtype") + text("f8") + b"\x85R"
    shape = b"J\xff\xff\xff\x7f\x85"
    return b"\x80\x04}" + text("a") + begun + b"(K\x01" + shape + kind + b"\x89C\x08" + bytes(8) + b"tbs."


def large_allocation(_: str) -> bytes:
    """Would make an empty array of eight gigabytes."""
    return call(stack_global("numpy", "ndarray"), b"J\x00\x00\x00\x40\x85")


def large_beginning(_: str) -> bytes:
    array = stack_global("numpy", "ndarray") + b"J\x00\x00\x00\x40\x85" + b"C\x01b"
    return (
        b"\x80\x04}" + text("a") + stack_global("numpy._core.multiarray", "_reconstruct") + array + b"\x87Rs."
    )


def other_encoding(_: str) -> bytes:
    return call(stack_global("_codecs", "encode"), text("x"), text("rot13"))


def extension_code(_: str) -> bytes:
    return b"\x80\x02\x82\x01."


def persistent_id(_: str) -> bytes:
    return b"\x80\x04}" + text("a") + text("id") + b"Qs."


def persistent_id_of_protocol_0(_: str) -> bytes:
    return b"Pid\n."


def outside_buffer(_: str) -> bytes:
    return b"\x80\x05\x97."


def truncated(_: str) -> bytes:
    return pickle.dumps({"env_params_train": [np.arange(3.0)] * 5}, protocol=4)[:-20]


def not_a_pickle(_: str) -> bytes:
    return b"PK\x03\x04 this is an archive"


def a_page(_: str) -> bytes:
    return b"<!DOCTYPE html><html><body>404 not found</body></html>"


def empty(_: str) -> bytes:
    return b""


def deep_list(_: str) -> bytes:
    return b"\x80\x04" + b"]" * 200_000 + b"a" * 199_999 + b"."


def deep_tuple_as_key(_: str) -> bytes:
    """Hashing it overflows the stack of the interpreter, which dies."""
    return b"\x80\x04})" + b"\x85" * 1_000_000 + b"K\x01s."


def wide_tuple_as_key(_: str) -> bytes:
    """Hashing it takes two to the power of 60 steps."""
    return b"\x80\x04})" + b"2\x86" * 60 + b"K\x01s."


def tuple_in_set(_: str) -> bytes:
    return b"\x80\x04\x8f()\x85\x90."


def distant_memo(_: str) -> bytes:
    """Would make the memo of the unpickler 64 gigabytes large."""
    return b"\x80\x04Nr\xff\xff\xff\xff."


def long_bytes(_: str) -> bytes:
    return b"\x80\x05\x96" + struct.pack("<Q", 1 << 60) + b"x."


HARMS: tuple[Harm, ...] = (
    shell,
    shell_of_protocol_0,
    instance_of_protocol_0,
    evaluation,
    execution,
    execution_of_python_2,
    attribute,
    partial,
    mapping,
    dotted_builtin,
    dotted_globals,
    dotted_alias,
    dotted_module,
    numpy_load,
    numpy_tester,
    numpy_compiler,
    numpy_member,
    numpy_writer,
    copy_reconstructor,
    torch_storage,
    torch_load,
    pandas_frame,
    object_array,
    plain_object_array,
    record_array,
    new_instance,
    new_instance_of_granted,
    state_of_granted,
    plain_state_of_granted,
    state_of_array,
    shape_beyond_content,
    large_allocation,
    large_beginning,
    other_encoding,
    extension_code,
    persistent_id,
    persistent_id_of_protocol_0,
    outside_buffer,
    truncated,
    not_a_pickle,
    a_page,
    empty,
    deep_list,
    deep_tuple_as_key,
    wide_tuple_as_key,
    tuple_in_set,
    distant_memo,
    long_bytes,
)

HARMFUL: tuple[Harm, ...] = (
    shell,
    shell_of_protocol_0,
    instance_of_protocol_0,
    evaluation,
    execution,
    execution_of_python_2,
    partial,
    mapping,
    numpy_load,
    numpy_tester,
    numpy_writer,
    object_array,
)
"""Those that leave their trace under `pickle.load`, which proves that the others are worth refusing."""
