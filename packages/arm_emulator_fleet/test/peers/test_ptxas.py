"""NVIDIA's assembler takes our PTX for each of its cards."""

import re
import struct
from pathlib import Path

import pytest
from test_gpu_compiler import KERNELS, cache, make_unit, needs_clang

from arm_emulator_fleet.gpu_compiler import ARCHITECTURES, has_ptxas, load_cubin

__all__ = ["cache"]
needs_ptxas = pytest.mark.skipif(not has_ptxas(), reason="pip install nvidia-cuda-nvcc-cu12")
CUDA = 190  # EM_CUDA of ELF


@needs_clang
@needs_ptxas
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_ptx_is_assembled_for_every_card(architecture: str, tmp_path: Path) -> None:
    content = load_cubin(make_unit(), architecture)
    assert content[:4] == b"\x7fELF" and struct.unpack_from("<H", content, 18) == (CUDA,)
    for name in re.findall(r"KERNEL\((\w+), \w+\) \{", KERNELS.read_text()):
        assert b"\0.text." + name.encode() + b"\0" in content
    assert b"\0offsets\0" in content
