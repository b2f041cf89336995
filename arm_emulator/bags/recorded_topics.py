"""The topics of our network in a bag, which may stand in a namespace."""

from collections.abc import Iterator
from typing import Any

from rclpy.serialization import deserialize_message

from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.build_facts import COMPILED_WITH
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.ros.messages.fixed_layout import FixedLayout
from arm_emulator.ros.messages.message_types import get_message_class, list_fields, read_definition
from arm_emulator.ros.messages.node_topics import TYPES
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import SCENE

READ = (
    "motor_commands",
    "motor_states",
    "tool_target",
    "joint_targets",
    "motion/status",
    "emulator/joint_states",
    "emulator/events",
    "emulator/status",
    "robot_description",
    "diagnostics",
)
ALIKE = ("motor_states", "emulator/joint_states", "motor_commands")  # but for their numbers


class RecordedTopics:
    """Our topics in one bag.

    Attributes:
        bag: the bag.
        names: full names in the bag, by the names of READ; those without messages are left out.

    Args:
        bag: the bag.

    Raises:
        Refusal: it has no motor states, or its messages are of another version.
    """

    def __init__(self, bag: Bag) -> None:
        self.bag = bag
        where = str(bag.path)
        states = [name for name in bag.topics if name.endswith("/motor_states")]
        if len(states) != 1:
            listed = ", ".join(states or sorted(bag.topics)) or "no topics"
            raise Refusal(where, "the bag", "have one topic motor_states", listed)
        namespace = states[0].removesuffix("motor_states")
        self.names: dict[str, str] = {}
        for name in READ:
            kind, topic = TYPES[name], bag.topics.get(namespace + name)
            if topic is None or not topic.count:
                if name == "motor_states":
                    raise Refusal(where, "the bag", f"have messages on {name}", "none")
                continue
            if topic.type != kind:
                raise Refusal(where, f"type of {topic.name}", f"be {kind}", topic.type)
            if topic.definition and list_fields(topic.definition) != list_fields(
                read_definition(kind)
            ):
                rule = f"be the {kind} of this version"
                raise Refusal(where, f"definition of {topic.name}", rule, "other fields")
            self.names[name] = topic.name

    def read_messages(self, *requested: str) -> Iterator[tuple[str, Any]]:
        """Yield name and message of some topics, in the order of publication.

        Raises:
            Refusal: a message cannot be read.
        """
        for name, message, _ in self.read_with_time(*requested):
            yield name, message

    def read_with_time(self, *requested: str) -> Iterator[tuple[str, Any, int]]:
        """Yield as `read_messages`, with the wall time of publication [ns]."""
        for name, data, published in self._read_data(requested):
            yield name, self._deserialise_message(name, data), published

    def read_in_place(self, *requested: str) -> Iterator[tuple[str, Any, int]]:
        """Yield as `read_with_time`; a message is overwritten by the next one of its topic.

        Of messages that are alike but for their numbers this takes a fifth of the time.
        """
        layouts: dict[str, FixedLayout] = {}
        for name, data, published in self._read_data(requested):
            layout = layouts.get(name)
            if layout is not None and layout.load_message(data):
                yield name, layout.message, published
                continue
            message = self._deserialise_message(name, data)
            if name in ALIKE:
                layouts[name] = FixedLayout(message)
            yield name, message, published

    def _read_data(self, requested: tuple[str, ...]) -> Iterator[tuple[str, bytes, int]]:
        names = {self.names[name]: name for name in requested if name in self.names}
        for record in self.bag.read_as_published(names):
            yield names[record.topic], record.data, record.published

    def _deserialise_message(self, name: str, data: bytes) -> Any:
        try:
            return deserialize_message(data, get_message_class(TYPES[name]))
        except RuntimeError as error:
            rule = "be readable"
            raise Refusal(str(self.bag.path), f"messages on {name}", rule, error) from None

    @property
    def is_real_time(self) -> bool:
        """Whether the emulator was paced by the clock."""
        return any(
            status.worst_lateness > 0.0 or status.overruns
            for _, status in self.read_messages("emulator/status")
        )

    @property
    def scene(self) -> str:
        """The scene in the bag's folder, the one that the emulator named, or the only fitting one.

        Raises:
            Refusal: no scene has these joints, or more than one.
        """
        own = self.bag.path / SCENE
        if own.is_file():
            return str(own)
        where, folder = str(self.bag.path), find_config_folder()
        for _, array in self.read_messages("diagnostics"):
            for status in array.status:
                if status.name.split("/")[-1] == "emulator" and status.hardware_id:
                    name = status.hardware_id.split("/")[-1]  # after the namespace
                    if (folder / f"{name}.yaml").is_file():
                        return str(name)
                    actual = f"none, and {name} is not shipped"
                    raise Refusal(where, "--scene", "name the scene's file", actual)
        _, state = next(self.read_messages("motor_states"))
        fitting = [
            file.stem
            for file in sorted(folder.glob("*.yaml"))
            if sorted(read_yaml(file).get("joints", {})) == sorted(state.joint_names)
        ]
        if len(fitting) != 1:
            rule = f"name the scene with the joints {', '.join(state.joint_names)}"
            raise Refusal(where, "--scene", rule, "none", ", ".join(fitting) or None)
        return fitting[0]

    @property
    def build(self) -> dict[str, str]:
        """Facts of the emulator's build that it has reported, see `build_facts`."""
        for _, array in self.read_messages("diagnostics"):
            for status in array.status:
                if status.name.split("/")[-1] == "emulator":
                    values = {pair.key: pair.value for pair in status.values}
                    if COMPILED_WITH in values:
                        return values
        return {}

    @property
    def missing(self) -> Iterator[str]:
        """Data that the bag lacks, a sentence each."""
        if not self.bag.complete:
            yield "messages after the bag's end: its recorder did not close it"
        for name, information in (
            ("motor_commands", "what was commanded"),
            ("emulator/joint_states", "the true state of the machine"),
            ("emulator/events", "whether the machine was changed by hand"),
            ("emulator/status", "whether this was lock-step, as assumed"),
        ):
            if not any(topic.endswith(f"/{name}") for topic in self.bag.topics):
                yield f"{information}: the bag has no {name}"

    def list_hints(self, scene: Scene) -> Iterator[str]:
        """Yield possible reasons for a difference, one sentence each."""
        for _, description in self.read_messages("robot_description"):
            if description.data != scene.urdf:
                yield f"the recorded robot_description is not that of scene {scene.name}"
            break
        if "emulator/events" not in self.names:
            yield "without emulator/events changes by hand are unknown"
        if "emulator/status" not in self.names:
            yield "without emulator/status the clock is unknown, lock-step is assumed"
