"""Recorded bags; they need ROS 2."""

from arm_emulator.bags.explanation import Explanation, explain_moment
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_ticks import (
    RecordedChange,
    RecordedTick,
    find_first_difference_of_bits,
)
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS as EVENT_KINDS
from arm_emulator.bags.run_bag import KINDS as CHANGE_KINDS
from arm_emulator.bags.run_bag import RunBag
from arm_emulator.bags.stop_in_record import measure_stop
from arm_emulator.bags.timeline_bag import write_timeline
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import SCENE as BAG_SCENE_FILE
