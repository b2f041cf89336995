"""EtherCAT slave information (ESI, ETG.2000): the file by which engineering tools know a drive."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence

from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT
from arm_emulator_fieldbus.object_dictionary import REALS, ObjectEntry

# As in core/ethercat/sii.hpp.
MAILBOX = 256
MAILBOX_OUT, MAILBOX_IN, OUTPUTS, INPUTS = 0x1000, 0x1100, 0x1200, 0x1500
VENDOR = "arm_emulator"
DEVICE = "arm_emulator drive"

_TYPES = {
    "BOOLEAN": "BOOL",
    "INTEGER8": "SINT",
    "INTEGER16": "INT",
    "INTEGER32": "DINT",
    "UNSIGNED8": "USINT",
    "UNSIGNED16": "UINT",
    "UNSIGNED32": "UDINT",
    "REAL32": "REAL",
    "REAL64": "LREAL",
}


def make_esi(drives: Drives) -> str:
    """Return the file for the drives of a scene, which are alike in all that it reports."""
    objects: dict[int, list[ObjectEntry]] = {}
    for entry in drives.entries:
        if entry.buses & ETHERCAT:
            objects.setdefault(entry.index, []).append(entry)
    vendor, product, revision = (_format_hex(drives.read(0, 0x1018, sub), 8) for sub in (1, 2, 3))
    coe = {"SdoInfo": "true", "PdoAssign": "true", "PdoConfig": "true", "CompleteAccess": "true"}
    free_run = _list_texts(Name="FreeRun", AssignActivate=_format_hex(0, 4))
    clocks = _list_texts(Name="DC", AssignActivate=_format_hex(0x300, 4))
    device = _make_element(
        "Device",
        _make_element("Type", DEVICE, ProductCode=product, RevisionNo=revision),
        *_list_texts(Name=DEVICE, GroupType="Drives"),
        _make_element(
            "Profile", _make_element("ProfileNo", "402"), _make_dictionary(drives, objects)
        ),
        *(_make_element("Fmmu", use) for use in ("Outputs", "Inputs", "MBoxState")),
        *_list_guards(drives),
        *_list_pdos(drives, objects),
        _make_element("Mailbox", _make_element("CoE", **coe), DataLinkLayer="true"),
        _make_element(
            "Dc",
            _make_element("OpMode", *free_run),
            _make_element("OpMode", *clocks, _make_element("CycleTimeSync0", "0", Factor="1")),
        ),
        _make_element("Eeprom", *_list_texts(ByteSize="2048", ConfigData="0500000000000000")),
        Physics="YY",
    )
    group = _make_element("Group", *_list_texts(Type="Drives", Name="Servo drives"))
    root = _make_element(
        "EtherCATInfo",
        _make_element("Vendor", *_list_texts(Id=vendor, Name=VENDOR)),
        _make_element(
            "Descriptions", _make_element("Groups", group), _make_element("Devices", device)
        ),
        Version="1.6",
    )
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _make_dictionary(drives: Drives, objects: dict[int, list[ObjectEntry]]) -> ET.Element:
    records, rows, plain = [], [], dict[str, int]()
    for index, entries in objects.items():
        plain |= dict(_find_type(drives, entry) for entry in entries)
        if len(entries) == 1:
            name, bits = _find_type(drives, entries[0])
        else:
            name = f"DT{index:04X}"
            bits, record = _make_record(drives, name, entries)
            records.append(record)
        texts = _list_texts(
            Index=_format_hex(index, 4), Name=entries[0].object, Type=name, BitSize=str(bits)
        )
        rows.append(_make_element("Object", *texts, _make_info(entries), _make_flags(entries[0])))
    for name, bits in plain.items():
        records.append(_make_element("DataType", *_list_texts(Name=name, BitSize=str(bits))))
    return _make_element(
        "Dictionary", _make_element("DataTypes", *records), _make_element("Objects", *rows)
    )


def _make_record(
    drives: Drives, name: str, entries: Sequence[ObjectEntry]
) -> tuple[int, ET.Element]:
    """Return bits and data type of an object with subs; sub 0 is padded to 16."""
    subs, at = [], 0
    for entry in entries:
        type_, bits = _find_type(drives, entry)
        texts = _list_texts(
            SubIdx=str(entry.sub), Name=entry.name, Type=type_, BitSize=str(bits), BitOffs=str(at)
        )
        subs.append(_make_element("SubItem", *texts, _make_flags(entry)))
        at += 16 if entry.sub == 0 else bits
    return at, _make_element("DataType", *_list_texts(Name=name, BitSize=str(at)), *subs)


def _make_info(entries: Sequence[ObjectEntry]) -> ET.Element:
    info = _make_element("Info")
    for entry in entries:
        if entry.bits == 0:
            continue
        default = _make_element("DefaultValue", str(entry.standard))
        if len(entries) > 1:
            info.append(
                _make_element(
                    "SubItem", _make_element("Name", entry.name), _make_element("Info", default)
                )
            )
            continue
        if entry.type not in REALS:
            info.extend(_list_texts(MinValue=str(entry.least), MaxValue=str(entry.most)))
        info.append(default)
    return info


def _make_flags(entry: ObjectEntry) -> ET.Element:
    access = _make_element("Access", {"const": "ro"}.get(entry.access, entry.access))
    mapping = ("R" if entry.rx else "") + ("T" if entry.tx else "")
    return _make_element(
        "Flags", access, *([_make_element("PdoMapping", mapping)] if mapping else [])
    )


def _find_type(drives: Drives, entry: ObjectEntry) -> tuple[str, int]:
    if entry.bits == 0:
        size = len(drives.upload_entry(0, entry.index, entry.sub))
        return f"STRING({size})", 8 * size
    return _TYPES[entry.type], entry.bits


def _list_guards(drives: Drives) -> Iterator[ET.Element]:
    out, into = (_count_bytes(drives, assignment) for assignment in (0x1C12, 0x1C13))
    for name, start, control, size in (
        ("MBoxOut", MAILBOX_OUT, 0x26, MAILBOX),
        ("MBoxIn", MAILBOX_IN, 0x22, MAILBOX),
        ("Outputs", OUTPUTS, 0x64, out),
        ("Inputs", INPUTS, 0x20, into),
    ):
        mailbox = {"MinSize": "34", "MaxSize": str(MAILBOX)} if name.startswith("MBox") else {}
        reported = {
            "StartAddress": _format_hex(start, 4),
            "ControlByte": _format_hex(control, 2),
            "Enable": "1",
        }
        yield _make_element("Sm", name, DefaultSize=str(size), **mailbox, **reported)


def _count_bytes(drives: Drives, assignment: int) -> int:
    bits = 0
    for k in range(drives.read(0, assignment)):
        index = drives.read(0, assignment, k + 1)
        bits += sum(drives.read(0, index, sub + 1) & 0xFF for sub in range(drives.read(0, index)))
    return bits // 8


def _list_pdos(drives: Drives, objects: dict[int, list[ObjectEntry]]) -> Iterator[ET.Element]:
    """Yield the process data objects that have entries; those assigned name their sync manager."""
    for first, tag, assignment, manager in (
        (0x1600, "RxPdo", 0x1C12, "2"),
        (0x1A00, "TxPdo", 0x1C13, "3"),
    ):
        assigned = [drives.read(0, assignment, k + 1) for k in range(drives.read(0, assignment))]
        for index in sorted(object for object in objects if first <= object < first + 0x200):
            mapped = [drives.read(0, index, k + 1) for k in range(drives.read(0, index))]
            if mapped:
                texts = _list_texts(Index=_format_hex(index, 4), Name=objects[index][0].object)
                rows = (_make_mapped(objects, word) for word in mapped)
                guard = {"Sm": manager} if index in assigned else {}
                yield _make_element(tag, *texts, *rows, **guard)


def _make_mapped(objects: dict[int, list[ObjectEntry]], word: int) -> ET.Element:
    """Return the element of a mapping's word: index, sub and bits; index 0 is a gap."""
    at, sub, bits = word >> 16, word >> 8 & 0xFF, str(word & 0xFF)
    if not at:
        return _make_element("Entry", *_list_texts(Index=_format_hex(at, 4), BitLen=bits))
    entry = objects[at][sub]
    return _make_element("Entry", *_list_texts(
        Index=_format_hex(at, 4), SubIndex=str(sub), BitLen=bits, Name=entry.name,
        DataType=_TYPES[entry.type],
    ))  # fmt: skip


def _make_element(tag: str, *content: str | ET.Element, **attributes: str) -> ET.Element:
    element = ET.Element(tag, attributes)
    for part in content:
        if isinstance(part, str):
            element.text = part
        else:
            element.append(part)
    return element


def _list_texts(**texts: str) -> list[ET.Element]:
    return [_make_element(tag, text) for tag, text in texts.items()]


def _format_hex(number: int, digits: int) -> str:
    return f"#x{number:0{digits}X}"
