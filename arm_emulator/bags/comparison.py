"""A bag compared with the machine that is driven again under its commands."""

from dataclasses import dataclass
from pathlib import Path

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import BagRepetition, Difference
from arm_emulator.bags.tally import Tally
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.build_facts import build_facts, list_differing_builds
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.recording.bag import Bag

COMPARED = ("motor_states", "motor_commands", "emulator/joint_states", "emulator/events")


@dataclass(frozen=True)
class BagComparison:
    """Outcome of a comparison: what was compared, and the first difference.

    Attributes:
        scene: name of the machine's scene.
        lockstep: whether the bag is of lock-step.
        tally: counts of compared and omitted messages.
        fields: compared topics, with the compared fields of their messages.
        left_out: what could not be compared, a sentence each.
        others: topics that are not compared.
        difference: the first one; None: all is equal to the last bit.
        hints: what may explain it.
        about: further facts of the bag, such as the bag that it forked from.
    """

    scene: str
    lockstep: bool
    tally: Tally
    fields: dict[str, str]
    left_out: list[str]
    others: list[str]
    difference: str | None
    hints: list[str]
    about: dict[str, str]


def compare_bag(path: Path, scene_name: str | None = None) -> BagComparison:
    """Drive the machine again with the commands of a bag, up to the first bit that differs.

    Args:
        path: the bag.
        scene_name: scene file or name; None: the one that the bag names.

    Raises:
        Refusal: the bag is damaged or contains nothing to check, or there is no scene.
    """
    bag = Bag(path)
    topics = RecordedTopics(bag)
    scene = load_scene(scene_name or topics.scene)
    lockstep = not topics.is_real_time
    session = Session(scene, "lockstep", "first_answer")
    repetition = BagRepetition(session, bag, lockstep)
    tally = repetition.tally
    difference: str | None = None
    try:
        for name, message in topics.read_messages(*COMPARED):
            repetition.repeat_message(name, message)
    except Difference as deviation:
        difference = str(deviation)
    if not tally.runs:
        rule, actual = "hold a run from tick 0 on", f"{tally.before} states of later ticks"
        raise Refusal(str(path), "the bag", rule, actual, "record, then call emulator/reset")
    if difference is None and not tally.periods:
        rule, actual = "hold a servo period of a run", f"{tally.states} states of tick 0"
        raise Refusal(str(path), "the bag", rule, actual, "record while the machine runs")
    taken = {topics.names[name] for name in COMPARED if name in topics.names}
    return BagComparison(
        scene=scene.name,
        lockstep=lockstep,
        tally=tally,
        fields={name: of for name, of in repetition.fields.items() if name in topics.names},
        left_out=[*tally.left_out, *topics.missing],
        others=sorted(set(bag.topics) - taken),
        difference=difference,
        hints=[]
        if difference is None
        else [*topics.list_hints(scene), *_compare_builds(topics, session)],
        about=bag.about,
    )


def _compare_builds(topics: RecordedTopics, session: Session) -> list[str]:
    """Return how the build of the record and the present one differ, a sentence each."""
    builds = topics.build, build_facts(session.plant)
    return [
        f"other builds: {fact}" for fact in list_differing_builds(("record", "present"), *builds)
    ]
