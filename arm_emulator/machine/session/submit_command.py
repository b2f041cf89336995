"""The command of a client without ROS, taken by a session."""

from collections.abc import Mapping, Sequence

from arm_emulator.machine.session.session import Session


def submit_command(
    session: Session,
    tick: int,
    names: Sequence[str],
    command: Sequence[float],
    further: Mapping[str, Sequence[float]],
    *,
    powered: bool,
) -> None:
    """Offer a command and set the drives' power; in lock-step the tick passes.

    Args:
        session: the machine.
        tick: the tick that it answers.
        names: of the joints, in the order of the command.
        command: one per name [V, N m, A].
        further: inputs of motors beside it, by name.
        powered: whether the drives have power from now on.

    Raises:
        DuplicateCommand, Refusal: as `Session.offer`; nothing has changed.
    """
    with session.turn:
        session.offer(tick, names, command, further)
        if session.powered != powered:
            session.powered = powered
        if session.lockstep and session.may_advance:
            session.advance()
