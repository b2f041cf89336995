"""Counts of the messages of a bag that were compared, and of those that were not."""

from dataclasses import dataclass


@dataclass
class Tally:
    """Counts of compared and omitted messages.

    Attributes:
        runs: from tick 0 on.
        periods: servo periods computed.
        states: motor states.
        truths: messages on `emulator/joint_states`.
        commands: ticks whose commands are those of a recorded command.
        changes: by hand, within runs.
        refused: commands that every machine refuses.
        lost: motor states missing in the bag; the run was continued with commands.
        free: ticks at 0 V before the first command of a run.
        before: motor states before the first run's tick 0.
        after: motor states after it that belong to no run: their tick goes back, or the first ones
            are missing in the bag.
        first_after: position of the first of these.
        stray_truths: true joint states of no tick that the bag has.
        uncommanded: ticks in lock-step without a recorded command.
        held: commands in real time, where the command held is not known.
    """

    runs: int = 0
    periods: int = 0
    states: int = 0
    truths: int = 0
    commands: int = 0
    changes: int = 0
    refused: int = 0
    lost: int = 0
    free: int = 0
    before: int = 0
    after: int = 0
    first_after: str = ""
    stray_truths: int = 0
    uncommanded: int = 0
    held: int = 0

    def leave_out(self, where: str) -> None:
        """Count a motor state that belongs to no run."""
        if not self.runs:
            self.before += 1
            return
        self.after += 1
        self.first_after = self.first_after or where

    @property
    def compared(self) -> str:
        """Compared messages, as text."""
        parts = [
            f"{self.runs} run{'s' if self.runs > 1 else ''}",
            f"{self.states} motor states",
            f"{self.truths} true joint states",
            f"{self.commands} commands",
        ]
        extra = {
            "changes by hand": self.changes,
            "commands answer no state": self.refused,
            "ticks at 0 V before the first command": self.free,
        }
        return ", ".join(
            [*parts, *(f"{number} {name}" for name, number in extra.items() if number)]
        )

    @property
    def left_out(self) -> list[str]:
        """Omitted messages, a sentence each."""
        counts = {
            f"motor states that belong to no run, from {self.first_after} on": self.after,
            "motor states of a run that began before the recording": self.before,
            "states are missing, the run was continued with commands": self.lost,
            "true joint states of no tick that the bag has": self.stray_truths,
            "ticks whose commands no recorded one gives": self.uncommanded,
            "commands: in real time any may be held": self.held,
        }
        return [f"{number} {name}" for name, number in counts.items() if number]
