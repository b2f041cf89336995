"""A bag that a command will write after its run."""

from pathlib import Path

from arm_emulator.base.refusal import Refusal


def check_new_bag(where: str, folder: Path) -> None:
    """Refuse a bag that cannot be written, before the run.

    Raises:
        Refusal: it exists, or ROS 2 is not found.
    """
    try:
        import arm_emulator.bags.run_bag  # noqa: F401
    except ModuleNotFoundError as error:
        raise Refusal(where, "--bag", "find ROS 2", error) from None
    if folder.exists():
        raise Refusal(where, f"folder {folder}", "be new", "one that exists")
