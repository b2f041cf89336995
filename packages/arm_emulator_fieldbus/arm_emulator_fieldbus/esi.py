"""EtherCAT slave information (ESI, ETG.2000): the file by which engineering tools know a drive."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

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
    objects = _group_entries(drives)
    root = ET.Element("EtherCATInfo", Version="1.6")
    vendor = _add_element(root, "Vendor")
    _add_texts(vendor, Id=_format_hex(drives.read(0, 0x1018, 1), 8), Name=VENDOR)
    descriptions = _add_element(root, "Descriptions")
    group = _add_element(_add_element(descriptions, "Groups"), "Group")
    _add_texts(group, Type="Drives", Name="Servo drives")
    device = _add_element(_add_element(descriptions, "Devices"), "Device", Physics="YY")
    product, revision = (drives.read(0, 0x1018, sub) for sub in (2, 3))
    _add_element(
        device,
        "Type",
        DEVICE,
        ProductCode=_format_hex(product, 8),
        RevisionNo=_format_hex(revision, 8),
    )
    _add_texts(device, Name=DEVICE, GroupType="Drives")
    _add_profile(device, drives, objects)
    for use in ("Outputs", "Inputs", "MBoxState"):
        _add_element(device, "Fmmu", use)
    _add_guards(device, drives)
    for first, tag, assignment in ((0x1600, "RxPdo", 0x1C12), (0x1A00, "TxPdo", 0x1C13)):
        assigned = [drives.read(0, assignment, k + 1) for k in range(drives.read(0, assignment))]
        for index in sorted(object for object in objects if first <= object < first + 0x200):
            _add_pdo(device, drives, objects, tag, index, assigned)
    coe = {"SdoInfo": "true", "PdoAssign": "true", "PdoConfig": "true", "CompleteAccess": "true"}
    _add_element(_add_element(device, "Mailbox", DataLinkLayer="true"), "CoE", **coe)
    clocks = _add_element(device, "Dc")
    for name, activate in (("FreeRun", 0), ("DC", 0x300)):
        mode = _add_element(clocks, "OpMode")
        _add_texts(mode, Name=name, AssignActivate=_format_hex(activate, 4))
        if activate:
            _add_element(mode, "CycleTimeSync0", "0", Factor="1")
    _add_texts(_add_element(device, "Eeprom"), ByteSize="2048", ConfigData="0500000000000000")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


Objects = dict[int, list[ObjectEntry]]


def _group_entries(drives: Drives) -> Objects:
    out: Objects = {}
    for entry in drives.entries:
        if entry.buses & ETHERCAT:
            out.setdefault(entry.index, []).append(entry)
    return out


def _add_profile(device: ET.Element, drives: Drives, objects: Objects) -> None:
    profile = _add_element(device, "Profile")
    _add_element(profile, "ProfileNo", "402")
    dictionary = _add_element(profile, "Dictionary")
    types, rows = _add_element(dictionary, "DataTypes"), _add_element(dictionary, "Objects")
    plain: dict[str, int] = {}
    for index, entries in objects.items():
        row = _add_element(rows, "Object")
        if len(entries) == 1:
            name, bits = _find_type(drives, entries[0])
            plain[name] = bits
        else:
            name, bits = f"DT{index:04X}", _add_record(types, drives, index, entries, plain)
        _add_texts(
            row, Index=_format_hex(index, 4), Name=entries[0].object, Type=name, BitSize=str(bits)
        )
        _add_info(row, entries)
        _add_flags(row, entries[0])
    for name, bits in plain.items():
        _add_texts(_add_element(types, "DataType"), Name=name, BitSize=str(bits))


def _add_record(
    types: ET.Element,
    drives: Drives,
    index: int,
    entries: Iterable[ObjectEntry],
    plain: dict[str, int],
) -> int:
    """Add the data type of an object with subs; return its bits, sub 0 padded to 16."""
    data_type = _add_element(types, "DataType")
    _add_element(data_type, "Name", f"DT{index:04X}")
    subs, at = [], 0
    for entry in entries:
        name, bits = _find_type(drives, entry)
        plain[name] = bits
        subs.append((entry, name, bits, at))
        at += 16 if entry.sub == 0 else bits
    _add_element(data_type, "BitSize", str(at))
    for entry, name, bits, place in subs:
        sub = _add_element(data_type, "SubItem")
        _add_texts(sub, SubIdx=str(entry.sub), Name=entry.name, Type=name)
        _add_texts(sub, BitSize=str(bits), BitOffs=str(place))
        _add_flags(sub, entry)
    return at


def _add_info(row: ET.Element, entries: list[ObjectEntry]) -> None:
    info = _add_element(row, "Info")
    for entry in entries:
        if entry.bits == 0:
            continue
        where = info
        if len(entries) > 1:
            item = _add_element(info, "SubItem")
            _add_element(item, "Name", entry.name)
            where = _add_element(item, "Info")
        elif entry.type not in REALS:
            _add_texts(where, MinValue=str(entry.least), MaxValue=str(entry.most))
        _add_element(where, "DefaultValue", str(entry.standard))


def _add_flags(row: ET.Element, entry: ObjectEntry) -> None:
    flags = _add_element(row, "Flags")
    _add_element(flags, "Access", {"const": "ro"}.get(entry.access, entry.access))
    mapping = ("R" if entry.rx else "") + ("T" if entry.tx else "")
    if mapping:
        _add_element(flags, "PdoMapping", mapping)


def _find_type(drives: Drives, entry: ObjectEntry) -> tuple[str, int]:
    if entry.bits == 0:
        size = len(drives.upload(0, entry.index, entry.sub))
        return f"STRING({size})", 8 * size
    return _TYPES[entry.type], entry.bits


def _add_guards(device: ET.Element, drives: Drives) -> None:
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
        _add_element(device, "Sm", name, DefaultSize=str(size), **mailbox, **reported)


def _count_bytes(drives: Drives, assignment: int) -> int:
    bits = 0
    for k in range(drives.read(0, assignment)):
        index = drives.read(0, assignment, k + 1)
        bits += sum(drives.read(0, index, sub + 1) & 0xFF for sub in range(drives.read(0, index)))
    return bits // 8


def _add_pdo(
    device: ET.Element, drives: Drives, objects: Objects, tag: str, index: int, assigned: list[int]
) -> None:
    count = drives.read(0, index)
    if count == 0:
        return
    guard = {"Sm": "2" if tag == "RxPdo" else "3"} if index in assigned else {}
    pdo = _add_element(device, tag, **guard)
    _add_texts(pdo, Index=_format_hex(index, 4), Name=objects[index][0].object)
    for k in range(count):
        mapped = drives.read(0, index, k + 1)
        at, sub, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
        row = _add_element(pdo, "Entry")
        if not at:
            _add_texts(row, Index=_format_hex(at, 4), BitLen=str(bits))
            continue
        entry = objects[at][sub]
        _add_texts(row, Index=_format_hex(at, 4), SubIndex=str(sub), BitLen=str(bits))
        _add_texts(row, Name=entry.name, DataType=_TYPES[entry.type])


def _add_element(parent: ET.Element, tag: str, text: str = "", **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, tag, attributes)
    if text:
        element.text = text
    return element


def _add_texts(parent: ET.Element, **texts: str) -> None:
    for tag, text in texts.items():
        _add_element(parent, tag, text)


def _format_hex(number: int, digits: int) -> str:
    return f"#x{number:0{digits}X}"
