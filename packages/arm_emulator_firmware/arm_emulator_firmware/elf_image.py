"""Firmware in an ELF file: contents of memory, and addresses of functions."""

import bisect
import io
from pathlib import Path

from arm_emulator.extension.base import Refusal, read_bytes
from arm_emulator_firmware.unicorn_library import find_package

LARGEST = 1 << 28  # bytes
MAX_HEADERS = 4096  # of segments and of sections
MAX_SYMBOLS = 200_000
ARM = 40  # e_machine


class ElfImage:
    """An ELF file for a Cortex-M.

    Attributes:
        name: of the file.
        pieces: addresses and bytes that go into flash and RAM.

    Raises:
        Refusal: no such file, no ELF for 32-bit Arm, a damaged one, or nothing to load.
    """

    def __init__(self, file: Path) -> None:
        self.name = file.name
        content = read_bytes(file, LARGEST)
        if content[:4] != b"\x7fELF":
            raise Refusal(self.name, "file", "be an ELF file", "another")
        if content[4:6] != b"\x01\x01" or content[18:20] != ARM.to_bytes(2, "little"):
            rule = "be built for a little-endian 32-bit Arm"
            raise Refusal(self.name, "file", rule, "for another processor")
        find_package("elftools", "pyelftools")
        from elftools.elf.elffile import ELFFile
        from elftools.elf.sections import SymbolTableSection

        try:
            elf = ELFFile(io.BytesIO(content))
            self._check_counts(elf.num_segments(), elf.num_sections())
            segments = [segment for segment in elf.iter_segments("PT_LOAD") if segment["p_filesz"]]
            size = sum(int(segment["p_filesz"]) for segment in segments)
            if size > LARGEST:
                raise Refusal(self.name, "file", f"load at most {LARGEST >> 20} MiB", size)
            self.pieces = [(int(segment["p_paddr"]), bytes(segment.data())) for segment in segments]
            table = elf.get_section_by_name(".symtab")
            symbols = table if isinstance(table, SymbolTableSection) else None
            if symbols is not None and symbols.num_symbols() > MAX_SYMBOLS:
                rule = f"have at most {MAX_SYMBOLS} symbols"
                raise Refusal(self.name, "file", rule, symbols.num_symbols())
            functions = sorted(
                (symbol["st_value"] & ~1, symbol["st_size"], symbol.name)
                for symbol in (symbols.iter_symbols() if symbols is not None else ())
                if symbol["st_info"]["type"] == "STT_FUNC" and symbol.name
            )
        except Refusal:
            raise
        except Exception as error:  # errors of a damaged file
            rule = "be a sound ELF file"
            raise Refusal(self.name, "file", rule, f"{type(error).__name__} {error}") from None
        if not self.pieces:
            raise Refusal(self.name, "file", "hold something to load", "nothing")
        self._starts = [start for start, _, _ in functions]
        self._functions = functions

    def _check_counts(self, *counts: int) -> None:
        for count in counts:
            if count > MAX_HEADERS:
                rule = f"have at most {MAX_HEADERS} segments and sections"
                raise Refusal(self.name, "file", rule, count)

    def find_symbol(self, address: int) -> str:
        """Return the function at an address and how far in; empty: none is known there."""
        index = bisect.bisect_right(self._starts, address) - 1
        if index < 0:
            return ""
        start, size, name = self._functions[index]
        into = address - start
        if into >= max(size, 2):
            return ""
        return f"{name}+{into:#x}" if into else str(name)
