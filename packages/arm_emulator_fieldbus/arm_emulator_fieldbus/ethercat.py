"""A segment of EtherCAT slaves, a CiA 402 drive per joint of a scene: core/ethercat/ethercat.h."""

import errno
import os

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import (
    SERVO_FOLDER,
    TICK_FOLDERS,
    CData,
    Header,
    Library,
    Unit,
    compile_once,
)
from arm_emulator.extension.machine import Plant, Scene
from arm_emulator.extension.runs import ServoConfig
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import DRIVES_CORE, ETHERCAT, drives_unit

MEMORY = 0x3000  # bytes of a slave
LONGEST = 2048  # bytes of a frame that `Segment.frame` takes

SEGMENT = Header(DRIVES_CORE / "ethercat/ethercat.h", (DRIVES_CORE, *TICK_FOLDERS, SERVO_FOLDER))


def ethercat_unit() -> Unit:
    """Return drives and segment as a unit to compile."""
    source = '#include "ethercat/ethercat.cpp"\n'
    return drives_unit("ethercat", source, (SEGMENT,), "the EtherCAT segment")


ethercat_library = compile_once(ethercat_unit)


class Segment:
    """The drives of a scene on a line of EtherCAT.

    Attributes:
        drives: their object dictionaries.
        lockstep: a servo period per frame of process data; else by the clock.
        pointer: to ``ethercat_segment``.

    Args:
        scene: the machine, which begins where it starts.
        servo: gains and data sheets of the joints.
        lockstep: see above.
        calls: the library, if it has more in it than `ethercat_library`.

    Raises:
        Refusal: drives that do not fit the scene, or no compiler.
    """

    def __init__(
        self, scene: Scene, servo: ServoConfig, lockstep: bool, calls: Library | None = None
    ) -> None:
        self._calls = calls or ethercat_library()
        self.lockstep = lockstep
        self.drives = Drives(Plant(scene), servo, ETHERCAT, self._calls)
        period = round(scene.servo_period * 1e9)
        options = SEGMENT.make_struct(
            "ethercat_options", lockstep=lockstep, all=self.drives.pointer, period=period
        )
        self.pointer = self._calls.ethercat_new(options)
        self._room = SEGMENT.ffi.new("uint8_t[]", LONGEST)

    def __del__(self) -> None:
        pointer, self.pointer = getattr(self, "pointer", None), None
        if pointer:
            self._calls.ethercat_delete(pointer)

    def frame(self, frame: bytes, now: int = 0) -> bytes:
        """Pass an Ethernet frame through the slaves; return the reply, empty without one.

        Args:
            frame: without its check sequence.
            now: what a clock states [ns], where it is not lock-step.
        """
        size = min(len(frame), LONGEST)
        SEGMENT.ffi.memmove(self._room, frame, size)
        back = self._calls.ethercat_frame(self.pointer, self._room, size, now)
        return bytes(SEGMENT.ffi.buffer(self._room, back))

    def pass_period(self, now: int = 0) -> None:
        """Let a servo period pass without a frame; `now`: time of a clock [ns]."""
        self._calls.ethercat_period(self.pointer, now)

    @property
    def figures(self) -> CData:
        """Counters of the segment since its creation, as ``ethercat_figures``."""
        out = SEGMENT.make_struct("ethercat_figures")
        self._calls.ethercat_get_figures(self.pointer, out)
        return out

    def read_memory(self, slave: int) -> bytes:
        """Return registers and memory of a slave."""
        return bytes(SEGMENT.ffi.buffer(self._calls.ethercat_memory(self.pointer, slave), MEMORY))

    def open_interface(self, interface: str) -> int:
        """Return a descriptor of a network interface.

        Raises:
            Refusal: there is no such interface, or the system does not permit it.
        """
        descriptor = int(self._calls.ethercat_open(os.fsencode(interface)))
        if descriptor >= 0:
            return descriptor
        if -descriptor in (errno.EPERM, errno.EACCES):
            rule = "be open to this user (root, or the capability CAP_NET_RAW)"
            raise Refusal("ethercat", "--interface", rule, interface)
        if -descriptor == errno.EPFNOSUPPORT:
            raise Refusal("ethercat", "--interface", "be an Ethernet interface", interface)
        rule = "name an existing network interface (`ip link` lists them)"
        raise Refusal("ethercat", "--interface", rule, interface)

    def serve_frames(self, descriptor: int, seconds: float) -> None:
        """Serve frames for some time, or until a signal comes, or until the machine diverges.

        Raises:
            Refusal: the interface is gone.
        """
        result = self._calls.ethercat_serve(self.pointer, descriptor, round(seconds * 1e9))
        if result < 0:
            raise Refusal("ethercat", "--interface", "stay", os.strerror(-result))
