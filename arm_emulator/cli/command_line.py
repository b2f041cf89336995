"""The commands, their arguments and what runs them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from arm_emulator.base.config_files import ROBOTS
from arm_emulator.base.memory import is_want_of_memory
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.exit_code import CODE
from arm_emulator.ros.ctrl_c import CtrlC, end_at_once, exit_code


def main() -> None:
    """Run one command; exit code 2 and one line for input that is not taken."""
    end_at_once(CODE)
    arguments = _parser().parse_args()
    with CtrlC(CODE) as ctrl_c:
        try:
            sys.exit(arguments.run(arguments))
        except Refusal as refusal:
            print(refusal, file=sys.stderr)
            sys.exit(2)
        except Exception as error:
            if not is_want_of_memory(error):
                raise
            print(Refusal("arm_emulator", "memory", "suffice", repr(error)), file=sys.stderr)
            sys.exit(2)
    sys.exit(exit_code(ctrl_c.signal, CODE))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="arm_emulator", description="An industrial arm, emulated."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    new = commands.add_parser("new", help="make a scene, with servo and motion control, of a robot")
    new.add_argument("robot", type=Path, help="URDF or xacro source")
    new.add_argument(
        "arguments", nargs="*", metavar="NAME:=VALUE", help="arguments of the xacro source"
    )
    new.add_argument("--tool", metavar="LINK", help="where the arm ends (default: chosen)")
    new.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="that move, the rest is held (default: chosen)"
    )
    new.add_argument("--out", type=Path, metavar="FOLDER", help="(default: the robot's name, here)")
    new.add_argument("--force", action="store_true", help="write over files that are there")
    new.set_defaults(run=_new)

    validate = commands.add_parser("validate", help="compare a real machine with what others found")
    validate.add_argument("machine", help="manutec_r3, kuka_kr300")
    validate.add_argument(
        "runs", nargs="*", type=Path, help="of kuka_kr300: further records (default: those shipped)"
    )
    validate.add_argument("--out", type=Path, default=Path("out"), help="folder of the pictures")
    validate.set_defaults(run=_validate)

    identify = commands.add_parser("identify", help="find a scene's numbers from measured motion")
    identify.add_argument("scene", help="scene file or name: the machine as it is known")
    identify.add_argument("data", type=Path, help="record: .npz, .csv, or a bag's folder")
    identify.add_argument(
        "--fit", default="*", metavar="NAMES", help="what to find, by commas (default: all)"
    )
    identify.add_argument(
        "--hold", default="", metavar="NAMES", help="what to keep as it is, by commas"
    )
    identify.add_argument("--out", type=Path, default=Path("fitted.yaml"), metavar="SCENE")
    identify.add_argument(
        "--angles", choices=("rad", "deg"), default="rad", help="unit in the data"
    )
    identify.add_argument(
        "--side", choices=("link", "motor"), default="link", help="where motor angles are told"
    )
    identify.add_argument(
        "--delay", nargs="+", default=[], metavar="SIGNAL=S", help="how late tau or q_link come"
    )
    identify.add_argument(
        "--low-pass", type=float, default=10.0, metavar="HZ", help="(default: %(default)s)"
    )
    identify.add_argument(
        "--trust",
        type=float,
        default=0.5,
        help="share to which the scene's inertias and springs are good (default: %(default)s)",
    )
    identify.add_argument(
        "--as-is", action="store_true", help="do not ask whether axes, signs, units are right"
    )
    identify.add_argument(
        "--simulate", action="store_true", help="then fit by simulating free runs (compiles)"
    )
    identify.set_defaults(run=_identify)

    up = commands.add_parser("up", help="start the three nodes, end all when one ends")
    _scene(up)
    _clock(up)
    up.add_argument(
        "--start",
        choices=("free_run", "first_answer", "paused"),
        default="first_answer",
        help="what the machine does until the servo answers (default: %(default)s)",
    )
    up.add_argument("--rerun-port", type=int, default=0, help="where a Rerun viewer may connect")
    up.add_argument("--rerun-file", default="", help="Rerun recording to write")
    up.add_argument(
        "--record",
        type=Path,
        metavar="FOLDER",
        help="new bag, written by the emulator itself: complete whatever the network does",
    )
    up.add_argument("--namespace", default="", help="of all nodes and topics, such as /cell1")
    up.add_argument(
        "--use-sim-time", action="store_true", help="the nodes' own clocks follow the emulator's"
    )
    up.add_argument(
        "--params-file", type=Path, help="ROS parameter file that rules over all other parameters"
    )
    up.set_defaults(run=_up)

    demo = commands.add_parser("demo", help="the paper's experiment, with pictures")
    demo.add_argument(
        "scene", nargs="?", default="three_axis", help="scene file or name, or a robot's URDF"
    )
    _clock(demo)
    demo.add_argument("--out", type=Path, default=Path("out"), help="folder for the results")
    demo.set_defaults(run=_demo)

    run = commands.add_parser("run", help="the same without a network, as fast as it goes")
    _scene(run)
    run.add_argument(
        "--seconds", type=float, help="logical time (default: 10, or as long as the table lasts)"
    )
    run.add_argument(
        "--displacement",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="where to bring the tool, from where it starts (m, in the world; default: nowhere)",
    )
    run.add_argument(
        "--targets",
        type=Path,
        metavar="TABLE",
        help="joint targets in place of the motion controller: CSV with t and the joints' names",
    )
    run.add_argument(
        "--servo",
        type=Path,
        metavar="LIBRARY",
        help="control code in C in place of our servo; with --targets",
    )
    run.set_defaults(run=_run)

    modbus = commands.add_parser(
        "modbus", help="the paper's data converter on a serial port, in Modbus RTU"
    )
    _scene(modbus)
    modbus.add_argument(
        "--clock",
        choices=("lockstep", "line", "realtime"),
        default="lockstep",
        help="a servo period per write of commands, logical time by what the line takes, or the "
        "wall clock (default: %(default)s)",
    )
    modbus.add_argument("--baud", type=int, default=115_200, help="(default: %(default)s)")
    modbus.add_argument(
        "--station", type=int, default=1, help="address on the line (default: %(default)s)"
    )
    modbus.add_argument(
        "--error-rate",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="of bytes that are lost or damaged on the line (default: %(default)s)",
    )
    modbus.add_argument("--seed", type=int, default=0, help="of these errors")
    modbus.add_argument(
        "--watchdog",
        type=int,
        default=100,
        metavar="MS",
        help="after which a silent master's drives are off; 0: never (default: %(default)s)",
    )
    modbus.add_argument("--link", type=Path, metavar="PATH", help="link to the port, to be made")
    modbus.add_argument(
        "--registers", action="store_true", help="print the table of registers, and end"
    )
    modbus.set_defaults(run=_modbus)

    ethercat = commands.add_parser(
        "ethercat", help="a CiA 402 drive per joint on EtherCAT, for the master of your choice"
    )
    _scene(ethercat)
    ethercat.add_argument(
        "--interface", metavar="IF", help="network interface that the master is connected to"
    )
    ethercat.add_argument(
        "--esi",
        type=Path,
        metavar="FILE",
        help="write the description of the slaves (ESI), and end",
    )
    clocks = ethercat.add_mutually_exclusive_group()
    clocks.add_argument(
        "--lockstep",
        dest="lockstep",
        action="store_true",
        default=True,
        help="a servo period per frame of process data (default)",
    )
    clocks.add_argument(
        "--realtime", dest="lockstep", action="store_false", help="servo periods by the clock"
    )
    ethercat.set_defaults(run=_ethercat)

    canopen = commands.add_parser("canopen", help="the joints' drives as nodes of CANopen")
    _scene(canopen)
    canopen.add_argument(
        "--listen",
        default="127.0.0.1:29536",
        metavar="[HOST:]PORT",
        help="offer the bus there, as socketcand does (default: %(default)s)",
    )
    canopen.add_argument(
        "--bus", help="in place of this one of python-can: socketcan, udp_multicast, ..."
    )
    canopen.add_argument("--channel", help="of that bus, such as can0")
    canopen.add_argument("--bitrate", type=int, help="for buses that need it told")
    canopen.add_argument(
        "--first-node",
        type=int,
        default=1,
        metavar="ID",
        help="node-ID of the first joint; the others follow (default: %(default)s)",
    )
    _clock(canopen)
    canopen.add_argument(
        "--eds", type=Path, metavar="FOLDER", help="write the drives' data sheets, and end"
    )
    canopen.set_defaults(run=_canopen)

    firmware = commands.add_parser(
        "firmware", help="run unmodified firmware of a Cortex-M4F in the loop with a machine"
    )
    firmware.add_argument("board", type=Path, help="which register is wired to what (YAML)")
    firmware.add_argument("elf", type=Path, metavar="FIRMWARE", help="ELF file")
    firmware.add_argument("--scene", default="three_axis", help="scene file or name")
    firmware.add_argument(
        "--targets", type=Path, metavar="TABLE", help="joint targets: CSV with t and joints' names"
    )
    firmware.add_argument(
        "--seconds", type=float, help="logical time (default: 10, or as long as the table lasts)"
    )
    firmware.add_argument(
        "--gdb", type=int, metavar="PORT", help="wait there for gdb, on 127.0.0.1"
    )
    firmware.add_argument(
        "--uart",
        nargs="+",
        default=[],
        metavar="NAME=WHERE",
        help="a serial line of the board: stdout, pty or none (default: the first to stdout)",
    )
    firmware.set_defaults(run=_firmware)

    header = commands.add_parser(
        "servo-header", help="write what our servo in C knows of a scene's joints as a C header"
    )
    _scene(header)
    header.add_argument("--out", type=Path, metavar="FILE", help="(default: the terminal)")
    header.set_defaults(run=_servo_header)

    fmu = commands.add_parser("fmu", help="write the machine as a unit for simulators (FMI)")
    fmu.add_argument("scene", help="scene file or name")
    fmu.add_argument("--out", type=Path, required=True, metavar="FILE", help="such as arm.fmu")
    fmu.add_argument(
        "--varied",
        metavar="NAMES",
        help="numbers that become parameters, by commas (default: those that the scene lists)",
    )
    fmu.add_argument(
        "--target",
        help="processors of its binary: a level (default: x86-64-v2), or native, this machine's",
    )
    fmu.add_argument("--fmi", choices=("3", "2"), default="3", help="version (default: 3.0)")
    fmu.add_argument(
        "--windows", action="store_true", help="with a binary for 64-bit Windows, too (by mingw)"
    )
    fmu.set_defaults(run=_fmu)

    compile_ = commands.add_parser("compile", help="compile a scene ahead of its first use")
    _scene(compile_)
    compile_.add_argument(
        "--target",
        default="native",
        help="native (this machine's processor, the default), or a level such as x86-64-v3 "
        "for machines without a compiler",
    )
    compile_.add_argument("--into", type=Path, help="folder for the library (default: the cache)")
    compile_.add_argument("--fleet", action="store_true", help="also many arms side by side")
    compile_.add_argument("--fieldbus", action="store_true", help="also what field buses need")
    compile_.set_defaults(run=_compile)

    cache = commands.add_parser("cache", help="list the compiled scenes that are kept")
    cache.add_argument("--clear", action="store_true", help="remove them")
    cache.set_defaults(run=_cache)

    advise = commands.add_parser("advise", help="find the cheapest scheme and step for an error")
    _scene(advise)
    advise.add_argument(
        "--error",
        type=float,
        default=1e-4,
        help="largest error of a link on the way (rad or m, default: %(default)s)",
    )
    advise.add_argument(
        "--motion",
        type=Path,
        metavar="FILE",
        help="to judge by: a bag, or a CSV of commands with t and the joints' names "
        "(default: the scene's demo and motions of many kinds)",
    )
    advise.add_argument("--write", action="store_true", help="put the result into the scene file")
    advise.set_defaults(run=_advise)

    tune = commands.add_parser("tune", help="compute a servo's gains; margins, steps, encoders")
    _scene(tune)
    tune.add_argument("--out", type=Path, metavar="FOLDER", help="where to draw a picture")
    tune.add_argument(
        "--payload", type=float, metavar="KG", help="mass at the tool, in place of the scene's"
    )
    tune.add_argument("--write", action="store_true", help="put the gains into the servo's file")
    tune.set_defaults(run=_tune)

    check = commands.add_parser("check-scene", help="say whether scene files are valid")
    check.add_argument("scenes", nargs="+", metavar="SCENE")
    check.add_argument(
        "--modes",
        action="store_true",
        help="show the eigenvalues of every loop that the scene's drives can be put into",
    )
    check.set_defaults(run=_check_scene)

    record = commands.add_parser("record", help="record the network into a rosbag2 bag")
    record.add_argument("out", type=Path, help="folder of the new bag")
    _topics(record)
    record.add_argument(
        "--from-start",
        action="store_true",
        help="reset a machine that runs already: `check` needs a run from tick 0 on",
    )
    record.set_defaults(run=_record)

    repair = commands.add_parser("repair", help="make a whole bag of a killed recorder's")
    repair.add_argument("bag", type=Path)
    repair.set_defaults(run=_repair)

    replay = commands.add_parser("replay", help="publish what a bag holds, at the recorded times")
    replay.add_argument("bag", type=Path)
    _topics(replay)
    replay.add_argument(
        "--rate", type=float, default=1.0, help="recorded seconds per second (default: 1)"
    )
    replay.add_argument("--wait", action="store_true", help="begin when every topic has a listener")
    replay.set_defaults(run=_replay)

    check_bag = commands.add_parser(
        "check", help="drive the machine again with recorded commands and compare every bit"
    )
    check_bag.add_argument("bag", type=Path)
    check_bag.add_argument("--scene", help="scene file or name (default: as the bag tells)")
    check_bag.add_argument(
        "--strict",
        action="store_true",
        help="exit code 1 also where anything is not compared",
    )
    check_bag.set_defaults(run=_check)
    return parser


def _scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", nargs="?", default="three_axis", help="scene file or name")


def _topics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="these only (default: all)")


def _clock(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--clock",
        choices=("lockstep", "realtime"),
        default="lockstep",
        help="logical time, the same bits every time, or the wall clock (default: %(default)s)",
    )


# Each command imports what it needs when it runs, so that the others start at once.


def _validate(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.validate import validate

    return validate(arguments.machine, arguments.runs, arguments.out)


def _identify(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.identify import identify

    fit, hold = (
        [one for one in text.split(",") if one] for text in (arguments.fit, arguments.hold)
    )
    return identify(
        arguments.scene,
        arguments.data,
        fit,
        hold,
        arguments.out,
        angles=arguments.angles,
        side=arguments.side,
        delays=arguments.delay,
        low_pass=arguments.low_pass,
        trust=arguments.trust,
        as_is=arguments.as_is,
        simulate=arguments.simulate,
    )


def _new(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.new import new

    given = dict[str, str]()
    for one in arguments.arguments:
        name, sign, value = one.partition(":=")
        if not sign or not name:
            raise Refusal("new", "argument", "be NAME:=VALUE", one)
        given[name] = value
    return new(
        arguments.robot,
        arguments.out,
        arguments.tool,
        arguments.joints,
        given,
        force=arguments.force,
    )


def _up(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.up import up

    return up(
        arguments.scene,
        arguments.clock,
        arguments.start,
        arguments.rerun_port,
        arguments.rerun_file,
        record=arguments.record,
        namespace=arguments.namespace,
        use_sim_time=arguments.use_sim_time,
        params_file=arguments.params_file,
    )


def _demo(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.demo import demo

    scene = arguments.scene
    if Path(scene).suffix in ROBOTS:
        from arm_emulator.cli.new import scene_of_robot

        scene = str(scene_of_robot(Path(scene), arguments.out))
    return demo(scene, arguments.clock, arguments.out)


def _run(arguments: argparse.Namespace) -> int:
    if arguments.targets is not None:
        if arguments.displacement is not None:
            raise Refusal("run", "--displacement", "stand without --targets", "both")
        from arm_emulator.cli.run import run_table

        return run_table(arguments.scene, arguments.seconds, arguments.targets, arguments.servo)
    if arguments.servo is not None:
        raise Refusal("run", "--servo", "come with --targets, a table of joint targets", "none")
    from arm_emulator.cli.run import run

    seconds = 10.0 if arguments.seconds is None else arguments.seconds
    return run(arguments.scene, seconds, arguments.displacement)


def _modbus(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.modbus import modbus, print_registers

    if arguments.registers:
        return print_registers(arguments.scene)
    return modbus(
        arguments.scene,
        clock=arguments.clock,
        baud=arguments.baud,
        station=arguments.station,
        error_rate=arguments.error_rate,
        seed=arguments.seed,
        watchdog=arguments.watchdog,
        link=arguments.link,
    )


def _ethercat(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.ethercat import serve, write_esi

    if arguments.esi is not None:
        return write_esi(arguments.scene, arguments.esi)
    if arguments.interface is None:
        raise Refusal("ethercat", "--interface", "name a network interface", "none")
    return serve(arguments.scene, arguments.interface, arguments.lockstep)


def _canopen(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.canopen import canopen, write_eds

    if arguments.eds is not None:
        return write_eds(arguments.scene, arguments.eds)
    return canopen(
        arguments.scene,
        listen=arguments.listen,
        bus=arguments.bus,
        channel=arguments.channel,
        bitrate=arguments.bitrate,
        first=arguments.first_node,
        clock=arguments.clock,
    )


def _firmware(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.firmware import run

    return run(
        arguments.board,
        arguments.elf,
        arguments.scene,
        targets=arguments.targets,
        seconds=arguments.seconds,
        gdb=arguments.gdb,
        uarts=arguments.uart,
    )


def _servo_header(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.servo_header import write_header

    return write_header(arguments.scene, arguments.out)


def _fmu(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.fmu import write_fmu

    varied = arguments.varied
    names = None if varied is None else [one for one in varied.split(",") if one]
    return write_fmu(
        arguments.scene, arguments.out, names, arguments.target, arguments.fmi, arguments.windows
    )


def _compile(arguments: argparse.Namespace) -> int:
    from arm_emulator.build.unit import compile_units
    from arm_emulator.machine.compiler import compile_ahead
    from arm_emulator.machine.firmware_loop import firmware_loop_unit
    from arm_emulator.machine.scene import load_scene
    from arm_emulator.runs.servo_step import servo_step_unit
    from arm_emulator.servo.servo_law import servo_unit

    scene = load_scene(arguments.scene)
    of_scene = compile_ahead(scene, arguments.target, arguments.into, fleet=arguments.fleet)
    code = [servo_unit(), servo_step_unit(), firmware_loop_unit()]
    if arguments.fieldbus:
        from arm_emulator.doors.fieldbus.drives import drives_unit
        from arm_emulator.doors.fieldbus.ethercat import ethercat_unit

        code += [drives_unit(), ethercat_unit()]
    for library in [*of_scene, *compile_units(code, arguments.target, arguments.into)]:
        print(library)
    return 0


def _cache(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.cache import clear_cache, list_cache

    return clear_cache() if arguments.clear else list_cache()


def _advise(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.advise import advise_scene

    return advise_scene(arguments.scene, arguments.error, arguments.motion, write=arguments.write)


def _tune(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.tune import tune

    return tune(arguments.scene, arguments.out, arguments.payload, write=arguments.write)


def _check_scene(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.check_scene import check_scene, modes_of

    for name in arguments.scenes:
        print(check_scene(name))
        if arguments.modes:
            print(modes_of(name))
    return 0


def _record(arguments: argparse.Namespace) -> int:
    from arm_emulator.ros.recorder_presence import RecorderPresence

    # Before anything that takes time: an emulator that is started together with this command waits.
    with RecorderPresence(arguments.topics) as presence:
        from arm_emulator.cli.record import record

        return record(arguments.out, arguments.topics, arguments.from_start, presence)


def _repair(arguments: argparse.Namespace) -> int:
    from arm_emulator.ros.bag import Bag, repair

    try:
        mended = repair(arguments.bag)
    except OSError as error:
        raise Refusal("repair", str(arguments.bag), "be writable", error.strerror) from None
    count = sum(topic.count for topic in Bag(arguments.bag).topics.values())
    print(f"{arguments.bag}: {count} messages, {'mended' if mended else 'was whole already'}")
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.replay import replay

    return replay(arguments.bag, arguments.topics, arguments.rate, arguments.wait)


def _check(arguments: argparse.Namespace) -> int:
    from arm_emulator.cli.check import check

    return check(arguments.bag, arguments.scene, arguments.strict)
