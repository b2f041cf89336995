"""The electronic data sheet of a node, by CiA 306, for the tools of CANopen masters."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from arm_emulator.extension.base import escape_to_line
from arm_emulator_fieldbus.canopen_node import Node
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.object_dictionary import REALS, TYPES, ObjectEntry, list_entries

_CODES = {name: code for code, name in TYPES.items()}
_MANDATORY = (0x1000, 0x1001, 0x1018)
_BAUD_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)


def make_eds(node: Node, file_name: str, product: str) -> str:
    """Return the data sheet of a node that was just made, with its values as defaults.

    Args:
        node: the drive's node; the sheet is one for every node-ID.
        file_name: under which it will be kept.
        product: name of the device.
    """
    file_name, product = escape_to_line(file_name), escape_to_line(product)
    entries = [entry for entry in list_entries() if entry.buses & CANOPEN]
    objects = [list(group) for _, group in groupby(entries, key=lambda entry: entry.index)]
    indices = [group[0].index for group in objects]
    own = [index for index in indices if 0x2000 <= index < 0x6000]
    rest = [index for index in indices if index not in (*_MANDATORY, *own)]
    identity = [int.from_bytes(node.upload_entry(0x1018, sub), "little") for sub in (1, 2, 3)]
    lines = [
        "[FileInfo]",
        f"FileName={file_name}",
        "FileVersion=1",
        "FileRevision=0",
        "EDSVersion=4.0",
        f"Description={product}, an emulated drive",
        "",
        "[DeviceInfo]",
        "VendorName=arm_emulator",
        f"VendorNumber=0x{identity[0]:08X}",
        f"ProductName={product}",
        f"ProductNumber=0x{identity[1]:08X}",
        f"RevisionNumber=0x{identity[2]:08X}",
        *(f"BaudRate_{rate}=1" for rate in _BAUD_RATES),
        "SimpleBootUpMaster=0",
        "SimpleBootUpSlave=1",
        "Granularity=8",
        "DynamicChannelsSupported=0",
        "GroupMessaging=0",
        "NrOfRXPDO=4",
        "NrOfTXPDO=4",
        "LSS_Supported=0",
        "",
        "[DummyUsage]",
        *(f"Dummy{index:04d}={int(index > 1)}" for index in range(1, 8)),
        "",
        *_write_list("MandatoryObjects", _MANDATORY),
        *_write_list("OptionalObjects", rest),
        *_write_list("ManufacturerObjects", own),
    ]
    for group in objects:
        first = group[0]
        section = f"{first.index:04X}"
        if first.code == 7:
            lines += _write_variable(node, section, first, first.object)
            continue
        lines += [
            f"[{section}]",
            f"SubNumber=0x{len(group):X}",
            f"ParameterName={first.object}",
            f"ObjectType=0x{first.code:X}",
            "",
        ]
        for entry in group:
            lines += _write_variable(node, f"{section}sub{entry.sub:X}", entry, entry.name)
    return "\n".join(lines)


def _write_list(name: str, indices: Sequence[int]) -> Iterable[str]:
    yield f"[{name}]"
    yield f"SupportedObjects={len(indices)}"
    for number, index in enumerate(indices, 1):
        yield f"{number}=0x{index:04X}"
    yield ""


def _write_variable(node: Node, section: str, entry: ObjectEntry, name: str) -> Iterable[str]:
    yield f"[{section}]"
    yield f"ParameterName={name}"
    yield "ObjectType=0x7"
    yield f"DataType=0x{_CODES[entry.type]:04X}"
    yield f"AccessType={entry.access}"
    if entry.access in ("const", "rw") and (default := _find_default(node, entry)) is not None:
        yield f"DefaultValue={default}"
    yield f"PDOMapping={int(entry.rx or entry.tx)}"
    signed = entry.type.startswith("INTEGER")
    half = 1 << max(entry.bits - 1, 0)
    has_range = entry.bits and entry.type not in REALS
    if has_range and (entry.least, entry.most) != (
        (-half, half - 1) if signed else (0, 2 * half - 1)
    ):
        yield f"LowLimit={_format_number(entry.least, signed)}"
        yield f"HighLimit={_format_number(entry.most, signed)}"
    if entry.unit:
        yield f"; unit: {entry.unit}"  # the standard has no key for it
    yield ""


def _format_number(value: int, signed: bool) -> str:
    return str(value) if signed else f"0x{value:X}"


def _find_default(node: Node, entry: ObjectEntry) -> str | None:
    """Return the text of an entry's value, or None if tools of masters read no common one."""
    raw = node.upload_entry(entry.index, entry.sub)
    if not entry.bits:
        return raw.decode()
    value = int.from_bytes(raw, "little")
    cob = entry.index == 0x1014 or (entry.sub == 1 and entry.index & 0xFE00 in (0x1400, 0x1800))
    if cob:
        return f"$NODEID+0x{value - node.number:X}"
    if (
        entry.type in REALS
    ):  # Lely's tools read the bits as a whole number, others the number itself
        return None if any(raw) else "0"
    signed = entry.type.startswith("INTEGER")
    return _format_number(int.from_bytes(raw, "little", signed=signed), signed)
