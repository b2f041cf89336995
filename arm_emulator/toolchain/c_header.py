"""C headers read by cffi: the only statement of structs, constants and signatures.

Reading a header takes about 30 ms. The result is cached beside the libraries, in the format of
``_cffi_backend``, which loads in less than 1 ms.
"""

import contextlib
import hashlib
import marshal
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import _cffi_backend
import numpy as np
import numpy.typing as npt

from arm_emulator.base.refusal import Refusal
from arm_emulator.toolchain import library_cache
from arm_emulator.workarounds.cffi_parts import read_parts

FFI = Any  # cffi has no types of its own
CData = Any

NULL: CData = _cffi_backend.FFI.NULL
SUFFIX = ".cdef"
_ARRAYS = _cffi_backend.FFI()
_NUMBERS = {
    np.dtype(name): f"{kind}[]"
    for name, kind in {
        "f8": "double", "f4": "float", "i8": "int64_t", "u8": "uint64_t", "i4": "int32_t",
        "u4": "uint32_t", "i2": "int16_t", "u2": "uint16_t", "i1": "int8_t", "u1": "uint8_t",
    }.items()
}  # fmt: skip
_INCLUDE = re.compile(r'#\s*include\s+(?:"([^"]+)"|<[^>]+>)')
_NUMBER = re.compile(r"-?(?:0x[0-9a-fA-F]+|\d+)")


def make_pointer(numbers: npt.NDArray[Any]) -> CData:
    """Return a pointer to the numbers of an array, which must be contiguous and outlive it."""
    return _ARRAYS.from_buffer(_NUMBERS[numbers.dtype], numbers)


def read_text(characters: CData) -> str:
    """Return a C string as text, up to its end or the array's."""
    return str(_ARRAYS.string(characters).decode(errors="replace"))


@dataclass(frozen=True)
class Header:
    """A header of this project; included headers are headers of their own.

    Attributes:
        ffi: cffi's view of it. All headers that include a header share its types.
        functions: those declared in this header.

    Args:
        path: its file.
        folders: folders of included headers that are not beside it.
    """

    path: Path
    folders: Sequence[Path] = ()
    ffi: FFI = field(init=False, repr=False, compare=False)
    functions: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        path = self.path.resolve()
        if path not in _READ:
            _READ[path] = _read_declarations(_Text(path, tuple(self.folders)))
        ffi, functions = _READ[path]
        object.__setattr__(self, "ffi", ffi)
        object.__setattr__(self, "functions", functions)

    def get_constant(self, name: str) -> int:
        """Return the value of an enumerator, or of a macro that is a whole number."""
        return int(self.ffi.integer_const(name))

    def get_size(self, kind: str) -> int:
        """Return the size of a struct [bytes]."""
        return int(self.ffi.sizeof(kind))

    def make_struct(self, kind: str, **values: Any) -> CData:
        """Return a pointer to a new struct of zeros, with its size set if it begins with one.

        Args:
            kind: name of the struct.
            values: of fields, see `fill_struct`.
        """
        return self.fill_struct(self.ffi.new(f"{kind} *"), **values)

    def fill_struct(self, struct: CData, **values: Any) -> CData:
        """Set fields of a struct, and its size if it begins with one; return it.

        Args:
            struct: a pointer to it.
            values: by the names of fields. A NumPy array stands for a pointer to its numbers: it
                must outlive the struct, and its type must be that of the field.
        """
        kinds, size = _list_fields(self.ffi.typeof(struct))
        if size:
            struct.size = size
        for name, value in values.items():
            if isinstance(value, np.ndarray) and name in kinds:
                value = self._cast_rows(kinds[name].type, value)
            setattr(struct, name, value)
        return struct

    def make_rows(self, kind: str, *shape: int) -> npt.NDArray[Any]:
        """Return a new array of structs, all zeros."""
        return np.zeros(shape, self.get_dtype(kind))

    def get_dtype(self, kind: str) -> np.dtype[Any]:
        """Return a struct as a NumPy dtype."""
        return _find_dtype(self.ffi, self.ffi.typeof(kind))

    def make_pointer(self, kind: str, rows: npt.NDArray[Any]) -> CData:
        """Return a pointer to an array of structs; the array must be contiguous and outlive it."""
        return self._cast_rows(self.ffi.typeof(f"{kind} *"), rows)

    def _cast_rows(self, kind: Any, rows: npt.NDArray[Any]) -> CData:
        if _find_dtype(self.ffi, kind.item) != rows.dtype:
            raise TypeError(f"{kind.cname} to an array of {rows.dtype}")
        return self.ffi.cast(kind, self.ffi.from_buffer(rows))


@cache  # a structure is filled in for every run
def _list_fields(kind: Any) -> tuple[dict[str, Any], int]:
    """Return the fields of what a type points to, and its size if it begins with one, else 0."""
    fields = kind.item.fields
    size = _cffi_backend.FFI().sizeof(kind.item) if fields[0][0] == "size" else 0
    return dict(fields), size


_OPEN: dict[str, list[tuple[FFI, CData]]] = {}  # cffi closes libraries without a reference


class Library:
    """A shared library: its functions, as headers declare them. It stays loaded until `close`.

    Attributes:
        file: where it is.

    Args:
        file: where it is.
        headers: headers that declare its functions.
        unload: whether `close` unloads it.

    Raises:
        OSError: the system does not load it.
        AttributeError: it lacks a function.
    """

    def __init__(self, file: str | Path, headers: Sequence[Header], unload: bool = False) -> None:
        self.file = str(file)
        for ffi, functions in ((header.ffi, header.functions) for header in headers):
            library = ffi.dlopen(self.file, ffi.RTLD_NOW | (0 if unload else ffi.RTLD_NODELETE))
            if unload:
                _OPEN.setdefault(self.file, []).append((ffi, library))
            vars(self).update((name, getattr(library, name)) for name in functions)

    def close(self) -> None:
        """Unload it; its functions must not be called afterwards."""
        for ffi, library in _OPEN.pop(self.file, []):
            ffi.dlclose(library)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{self.file}: no header declares {name}")


_DTYPES: dict[Any, np.dtype[Any]] = {}


def _find_dtype(ffi: FFI, kind: Any) -> np.dtype[Any]:
    if kind not in _DTYPES:
        _DTYPES[kind] = _build_dtype(ffi, kind)
    return _DTYPES[kind]


def _build_dtype(ffi: FFI, kind: Any) -> np.dtype[Any]:
    if kind.kind == "array":
        return np.dtype((_find_dtype(ffi, kind.item), (kind.length,)))
    if kind.kind in ("pointer", "function"):
        return np.dtype("u8")
    if kind.kind == "struct":
        fields = dict(kind.fields)
        return np.dtype({
            "names": list(fields),
            "formats": [_find_dtype(ffi, value.type) for value in fields.values()],
            "offsets": [value.offset for value in fields.values()],
            "itemsize": ffi.sizeof(kind),
        })  # fmt: skip
    size = ffi.sizeof(kind)
    if kind.cname in ("double", "float"):
        return np.dtype(f"f{size}")
    return np.dtype(f"{'i' if int(ffi.cast(kind, -1)) < 0 else 'u'}{size}")


_READ: dict[Path, tuple[FFI, tuple[str, ...]]] = {}


class _Text:
    """Declarations of a header, preprocessed for cffi's parser."""

    def __init__(self, path: Path, folders: tuple[Path, ...]) -> None:
        self.path, self.included = path, list[Header]()
        self._digest = hashlib.sha256(f"{_cffi_backend.__version__} {sys.version}".encode())
        lines = []
        text = path.read_text(encoding="utf-8")
        self._digest.update(text.encode())
        for line in _preprocess_lines(re.sub(r"/\*.*?\*/", " ", text, flags=re.S).splitlines()):
            include = _INCLUDE.match(line)
            if include is None:
                lines.append(line)
            elif include[1]:
                beside = (path.parent, *folders)
                file = next(at / include[1] for at in beside if (at / include[1]).is_file())
                self.included.append(Header(file, folders))
        self.text = "\n".join(lines)
        for header in self.included:
            self._digest.update(_DIGESTS[header.path.resolve()])
        _DIGESTS[path] = self._digest.digest()

    @property
    def name(self) -> str:
        """Its key in the cache."""
        return f"{self.path.stem}-{self._digest.hexdigest()[:20]}{SUFFIX}"


_DIGESTS: dict[Path, bytes] = {}


def _preprocess_lines(lines: list[str]) -> Iterator[str]:
    """Yield the lines that a C compiler sees, with no directives but includes and numbers."""
    defined, taken = set[str](), [True]
    for line in lines:
        words = line.lstrip().removeprefix("#").split() if line.lstrip().startswith("#") else []
        if not words:
            if taken[-1]:
                yield line
        elif words[0] in ("ifdef", "ifndef"):
            taken.append(taken[-1] and (words[1] in defined) == (words[0] == "ifdef"))
        elif words[0] == "else":
            taken[-1] = taken[-2] and not taken[-1]
        elif words[0] == "endif":
            taken.pop()
        elif taken[-1] and words[0] == "include":
            yield line.strip()
        elif taken[-1] and words[0] == "define":
            defined.add(words[1])
            if len(words) == 3 and _NUMBER.fullmatch(words[2]):
                yield line.strip()


def _read_declarations(text: _Text) -> tuple[FFI, tuple[str, ...]]:
    parts = _load_stored(text)
    if parts is None:
        parts = read_parts(_build_parser(text))
        _store_parts(text, parts)
    functions = parts.pop("functions")
    included = tuple(header.ffi for header in text.included)
    return _cffi_backend.FFI(text.path.stem, **parts, _includes=included), functions


def _load_stored(text: _Text) -> dict[str, Any] | None:
    for folder in library_cache.list_cache_folders():
        with contextlib.suppress(FileNotFoundError, library_cache.DamagedLibrary):
            parts: dict[str, Any] = marshal.loads(library_cache.read_library(folder / text.name))
            return parts
    return None


def _store_parts(text: _Text, parts: dict[str, Any]) -> None:
    # Without a writable cache, every process reads the headers.
    with contextlib.suppress(Refusal, OSError):
        folder = next(library_cache.list_writable_caches())
        file = folder / text.name
        with library_cache.lock_library(file), library_cache.make_scratch(file) as scratch:
            library_cache.store_file(file, marshal.dumps(parts), scratch)


_PARSERS: dict[Path, Any] = {}


def _build_parser(text: _Text) -> Any:
    """Return cffi's parser of a header, after it has read the included headers."""
    from cffi import FFI as Parser

    if text.path not in _PARSERS:
        _PARSERS[text.path] = parser = Parser()
        for header in text.included:
            parser.include(_build_parser(_Text(header.path.resolve(), tuple(header.folders))))
        parser.cdef(text.text)
        parser.set_source(text.path.stem, None)
    return _PARSERS[text.path]
