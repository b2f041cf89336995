"""The declarations of a header as data: cffi writes them as a module, which is read here.

Versions: cffi 1.16 to 2.1. Reason: parsing a header takes 30 ms, and cffi keeps the result as a
module of Python alone. The cache of libraries can neither check nor replace such a module as a
whole. Test: test/toolchain/test_workarounds.py, `test_cffi_offers_declarations_as_a_module_alone`.
"""

import ast
from io import StringIO
from typing import Any


def read_parts(parser: Any) -> dict[str, Any]:
    """Return what ``_cffi_backend.FFI`` gets for a parsed header, and its `functions`.

    Args:
        parser: a ``cffi.FFI`` that has read the header.
    """
    from cffi.cffi_opcode import OP_DLOPEN_FUNC
    from cffi.recompiler import Recompiler

    recompiler, source = Recompiler(parser, "parts", target_is_python=True), StringIO()
    recompiler.collect_type_table()
    recompiler.collect_step_tables()
    recompiler.write_source_to_f(source, None)
    call = ast.parse(source.getvalue()).body[-1]
    assert isinstance(call, ast.Assign) and isinstance(call.value, ast.Call)
    parts: dict[str, Any] = {
        keyword.arg: ast.literal_eval(keyword.value)
        for keyword in call.value.keywords
        if keyword.arg and keyword.arg != "_includes"
    }
    names = parts.get("_globals", ())[::2]  # an opcode, of which the last byte is the kind
    parts["functions"] = tuple(name[4:].decode() for name in names if name[3] == OP_DLOPEN_FUNC)
    return parts
