"""Compilers that do something else."""

from pathlib import Path


def fake_compiler(folder: Path, does: str) -> str:
    """A compiler that `does` something with the file "$out" that it shall make."""
    script = folder / f"fake_{len(list(folder.iterdir()))}"
    find_out = 'for word; do [ "$last" = -o ] && out=$word; last=$word; done'
    no_macros = 'case " $* " in *" -dM "*) exit 1;; esac'  # a question about the compiler
    script.write_text(f"#!/bin/sh\n{no_macros}\n{find_out}\n{does}\n")
    script.chmod(0o755)
    return str(script)
