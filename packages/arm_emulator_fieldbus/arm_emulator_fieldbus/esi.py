"""EtherCAT slave information (ESI, ETG.2000): the file by which engineering tools know a drive."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT
from arm_emulator_fieldbus.object_dictionary import REALS, Entry

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


def esi(drives: Drives) -> str:
    """Return the file for the drives of a scene, which are alike in all that it reports."""
    objects = _objects(drives)
    root = ET.Element("EtherCATInfo", Version="1.6")
    vendor = _add(root, "Vendor")
    _texts(vendor, Id=_hex(drives.read(0, 0x1018, 1), 8), Name=VENDOR)
    descriptions = _add(root, "Descriptions")
    group = _add(_add(descriptions, "Groups"), "Group")
    _texts(group, Type="Drives", Name="Servo drives")
    device = _add(_add(descriptions, "Devices"), "Device", Physics="YY")
    product, revision = (drives.read(0, 0x1018, sub) for sub in (2, 3))
    _add(device, "Type", DEVICE, ProductCode=_hex(product, 8), RevisionNo=_hex(revision, 8))
    _texts(device, Name=DEVICE, GroupType="Drives")
    _profile(device, drives, objects)
    for use in ("Outputs", "Inputs", "MBoxState"):
        _add(device, "Fmmu", use)
    _guards(device, drives)
    for first, tag, assignment in ((0x1600, "RxPdo", 0x1C12), (0x1A00, "TxPdo", 0x1C13)):
        assigned = [drives.read(0, assignment, k + 1) for k in range(drives.read(0, assignment))]
        for index in sorted(object for object in objects if first <= object < first + 0x200):
            _pdo(device, drives, objects, tag, index, assigned)
    coe = {"SdoInfo": "true", "PdoAssign": "true", "PdoConfig": "true", "CompleteAccess": "true"}
    _add(_add(device, "Mailbox", DataLinkLayer="true"), "CoE", **coe)
    clocks = _add(device, "Dc")
    for name, activate in (("FreeRun", 0), ("DC", 0x300)):
        mode = _add(clocks, "OpMode")
        _texts(mode, Name=name, AssignActivate=_hex(activate, 4))
        if activate:
            _add(mode, "CycleTimeSync0", "0", Factor="1")
    _texts(_add(device, "Eeprom"), ByteSize="2048", ConfigData="0500000000000000")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


Objects = dict[int, list[Entry]]


def _objects(drives: Drives) -> Objects:
    out: Objects = {}
    for entry in drives.entries:
        if entry.buses & ETHERCAT:
            out.setdefault(entry.index, []).append(entry)
    return out


def _profile(device: ET.Element, drives: Drives, objects: Objects) -> None:
    profile = _add(device, "Profile")
    _add(profile, "ProfileNo", "402")
    known = _add(profile, "Dictionary")
    types, rows = _add(known, "DataTypes"), _add(known, "Objects")
    plain: dict[str, int] = {}
    for index, entries in objects.items():
        row = _add(rows, "Object")
        if len(entries) == 1:
            name, bits = _type(drives, entries[0])
            plain[name] = bits
        else:
            name, bits = f"DT{index:04X}", _record(types, drives, index, entries, plain)
        _texts(row, Index=_hex(index, 4), Name=entries[0].object, Type=name, BitSize=str(bits))
        _info(row, entries)
        _add_flags(row, entries[0])
    for name, bits in plain.items():
        _texts(_add(types, "DataType"), Name=name, BitSize=str(bits))


def _record(
    types: ET.Element, drives: Drives, index: int, entries: Iterable[Entry], plain: dict[str, int]
) -> int:
    """Add the data type of an object with subs; return its bits, sub 0 padded to 16."""
    one = _add(types, "DataType")
    _add(one, "Name", f"DT{index:04X}")
    subs, at = [], 0
    for entry in entries:
        name, bits = _type(drives, entry)
        plain[name] = bits
        subs.append((entry, name, bits, at))
        at += 16 if entry.sub == 0 else bits
    _add(one, "BitSize", str(at))
    for entry, name, bits, place in subs:
        sub = _add(one, "SubItem")
        _texts(sub, SubIdx=str(entry.sub), Name=entry.name, Type=name)
        _texts(sub, BitSize=str(bits), BitOffs=str(place))
        _add_flags(sub, entry)
    return at


def _info(row: ET.Element, entries: list[Entry]) -> None:
    info = _add(row, "Info")
    for entry in entries:
        if entry.bits == 0:
            continue
        where = info
        if len(entries) > 1:
            item = _add(info, "SubItem")
            _add(item, "Name", entry.name)
            where = _add(item, "Info")
        elif entry.type not in REALS:
            _texts(where, MinValue=str(entry.least), MaxValue=str(entry.most))
        _add(where, "DefaultValue", str(entry.standard))


def _add_flags(row: ET.Element, entry: Entry) -> None:
    flags = _add(row, "Flags")
    _add(flags, "Access", {"const": "ro"}.get(entry.access, entry.access))
    mapping = ("R" if entry.rx else "") + ("T" if entry.tx else "")
    if mapping:
        _add(flags, "PdoMapping", mapping)


def _type(drives: Drives, entry: Entry) -> tuple[str, int]:
    if entry.bits == 0:
        size = len(drives.upload(0, entry.index, entry.sub))
        return f"STRING({size})", 8 * size
    return _TYPES[entry.type], entry.bits


def _guards(device: ET.Element, drives: Drives) -> None:
    out, into = (_bytes(drives, assignment) for assignment in (0x1C12, 0x1C13))
    for name, start, control, size in (
        ("MBoxOut", MAILBOX_OUT, 0x26, MAILBOX),
        ("MBoxIn", MAILBOX_IN, 0x22, MAILBOX),
        ("Outputs", OUTPUTS, 0x64, out),
        ("Inputs", INPUTS, 0x20, into),
    ):
        mailbox = {"MinSize": "34", "MaxSize": str(MAILBOX)} if name.startswith("MBox") else {}
        reported = {"StartAddress": _hex(start, 4), "ControlByte": _hex(control, 2), "Enable": "1"}
        _add(device, "Sm", name, DefaultSize=str(size), **mailbox, **reported)


def _bytes(drives: Drives, assignment: int) -> int:
    bits = 0
    for k in range(drives.read(0, assignment)):
        index = drives.read(0, assignment, k + 1)
        bits += sum(drives.read(0, index, one + 1) & 0xFF for one in range(drives.read(0, index)))
    return bits // 8


def _pdo(
    device: ET.Element, drives: Drives, objects: Objects, tag: str, index: int, assigned: list[int]
) -> None:
    count = drives.read(0, index)
    if count == 0:
        return
    guard = {"Sm": "2" if tag == "RxPdo" else "3"} if index in assigned else {}
    pdo = _add(device, tag, **guard)
    _texts(pdo, Index=_hex(index, 4), Name=objects[index][0].object)
    for k in range(count):
        mapped = drives.read(0, index, k + 1)
        at, sub, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
        row = _add(pdo, "Entry")
        if not at:
            _texts(row, Index=_hex(at, 4), BitLen=str(bits))
            continue
        entry = objects[at][sub]
        _texts(row, Index=_hex(at, 4), SubIndex=str(sub), BitLen=str(bits))
        _texts(row, Name=entry.name, DataType=_TYPES[entry.type])


def _add(parent: ET.Element, tag: str, text: str = "", **attributes: str) -> ET.Element:
    one = ET.SubElement(parent, tag, attributes)
    if text:
        one.text = text
    return one


def _texts(parent: ET.Element, **texts: str) -> None:
    for tag, text in texts.items():
        _add(parent, tag, text)


def _hex(number: int, digits: int) -> str:
    return f"#x{number:0{digits}X}"
