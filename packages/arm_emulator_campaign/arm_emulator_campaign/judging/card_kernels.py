"""Kernels of campaigns for a card, compiled ahead of their first use."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.extension.machine import Scene
from arm_emulator_campaign.judging.device_program import build_judges_unit
from arm_emulator_campaign.judging.device_sampler import KERNELS
from arm_emulator_fleet.gpu_compiler import compile_for_card
from arm_emulator_fleet.unit import build_card_units


def compile_campaign_for_card(scene: Scene, architecture: str, folder: Path | None) -> list[Path]:
    """Compile a scene's arms with their samples, and the judges; see `compile_for_card`.

    Raises:
        Refusal: see there; or no device advances the scene.
    """
    units = *build_card_units(scene, KERNELS), build_judges_unit()
    return [file for unit in units for file in compile_for_card(unit, architecture, folder)]
